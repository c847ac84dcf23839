"""Write the picture of the packages and the lists of modules in docs/architecture.md.

python docs/list_modules.py

Rows come from pyproject.toml (`tool.importlinter`), words from the first line of each docstring,
and what a module touches from its imports.
"""

import ast
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "clustermcl"
PAGE = ROOT / "docs" / "architecture.md"
LISTED = (
    *("ros2", "coordinator", "worker", "sensor_bridge", "jobs", "belief"),
    *("link", "recordings", "runtime", "protocol", "filter"),
)
TOUCHED = {
    "Zenoh": {"zenoh", "link"},
    "clock": {"time"},
    "log": {"logging"},
    "files": {"fcntl", "os", "pathlib", "shutil", "tempfile"},
}


def main() -> None:
    """Rewrite the page between the marks."""
    PAGE.write_text(renewed(PAGE.read_text()))


def renewed(page: str) -> str:
    """Return the page with the picture and the lists of the present files."""
    for mark, lines in (("rooms", picture()), ("modules", tables())):
        before, start, rest = page.partition(f"<!-- {mark}: python docs/list_modules.py -->\n")
        _, end, after = rest.partition(f"<!-- end of {mark} -->\n")
        page = "".join([before, start, *(f"{line}\n" for line in lines), end, after])
    return page


def picture() -> Iterator[str]:
    """Draw the packages as rows of boxes."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    layers = project["tool"]["importlinter"]["contracts"][0]["layers"]
    rows = [[room.strip() for room in layer.split("|")] for layer in layers]
    lines = [[f" {room:<14} {summary(source(room))} " for room in row] for row in rows]
    width = max(len(line) for row in lines for line in row)
    yield "```"
    yield f"┌{'─' * width}┐"
    for row in lines:
        if row is not lines[0]:
            yield f"├{'─' * width}┤  ↓ imports"
        yield from (f"│{line:<{width}}│" for line in row)
    yield f"└{'─' * width}┘"
    yield "```"


def tables() -> Iterator[str]:
    """A list for each folder: its modules, what they are for, and what they touch."""
    for room in LISTED:
        folders = sorted({file.parent for file in (PACKAGE / room).rglob("*.py")})
        for folder in folders:
            yield from (
                "",
                f"**`{folder.relative_to(PACKAGE)}/`** {summary(folder / '__init__.py')}",
                "",
            )
            for file in sorted(folder.glob("[!_]*.py")):
                means = f" *({', '.join(touched(file))})*" if touched(file) else ""
                yield f"* `{file.name}`: {summary(file)}{means}"
    yield ""


def source(room: str) -> Path:
    """Return the file that says what a room is: a folder's `__init__.py`, or the module itself."""
    return folder / "__init__.py" if (folder := PACKAGE / room).is_dir() else PACKAGE / f"{room}.py"


def summary(file: Path) -> str:
    """Return the first line of a file's docstring."""
    return (ast.get_docstring(ast.parse(file.read_text())) or "").partition("\n")[0]


def touched(file: Path) -> list[str]:
    """Return which of Zenoh, the clock, the log and files a module can use, by its imports."""
    imported = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            imported.add(node.module)
    names = {name.removeprefix("clustermcl.").partition(".")[0] for name in imported}
    return [thing for thing, modules in TOUCHED.items() if names & modules]


if __name__ == "__main__":
    main()
