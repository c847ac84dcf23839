"""The files that the page is made of."""

import importlib.resources


def static_files() -> dict[str, bytes]:
    """The page, by the names of its files."""
    folder = importlib.resources.files("live_view") / "static"
    return {file.name: file.read_bytes() for file in folder.iterdir() if file.is_file()}
