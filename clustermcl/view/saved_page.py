"""Writes the page of a recorded run as one HTML file that needs no server."""

import base64
import importlib.resources
import re
import zlib
from collections.abc import Mapping

import msgspec

from clustermcl.view.picture import MAX_EVENTS, Picture

_IMPORTED = re.compile(r'from "\./(\w+)\.js"')


def saved_run(picture: Picture) -> str:
    """Return an HTML page that plays all archived steps of a run."""
    archived = msgspec.json.encode(picture.archive.everything())
    past = base64.b64encode(zlib.compress(archived, 9)).decode()
    events = picture.events_until(most=MAX_EVENTS)
    shown = {**picture.everything(), "past": past, "events": events}
    if picture.map is not None:
        packed = base64.b64encode(picture.map.zlib_cells).decode()
        shown["map"] = {**shown["map"], "packed": packed}
    files = {name: content.decode() for name, content in static_files().items()}
    data = msgspec.json.encode(shown).decode().replace("<", "\\u003c")
    head = (
        f"<style>{files['style.css']}</style>\n"
        f'<script type="application/json" id="saved">{data}</script>\n'
        f'<script type="importmap">{_import_map(files)}</script>\n'
        '<script type="module">import "app";</script>\n'
    )
    page = re.sub(r"^ *<(link|script) .*\n", "", files["index.html"], flags=re.MULTILINE)
    return page.replace("</head>", f'<link rel="icon" href="data:,">\n{head}</head>')


def _import_map(files: Mapping[str, str]) -> str:
    """Return an import map that contains the scripts: the saved page cannot load other files."""
    scripts = {
        name.removesuffix(".js"): "data:text/javascript;base64,"
        + base64.b64encode(_IMPORTED.sub(r'from "\1"', text).encode()).decode()
        for name, text in files.items()
        if name.endswith(".js")
    }
    return msgspec.json.encode({"imports": scripts}).decode()


def static_files() -> dict[str, bytes]:
    folder = importlib.resources.files("clustermcl.view") / "static"
    return {file.name: file.read_bytes() for file in folder.iterdir() if file.is_file()}
