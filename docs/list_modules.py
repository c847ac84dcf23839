"""Write the picture and the list of folders in docs/architecture.md; list all modules for the site.

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
    """Return the page with the picture and the list of the present folders."""
    for mark, lines in (("rooms", picture()), ("folders", folders())):
        before, start, rest = page.partition(f"<!-- {mark}: python docs/list_modules.py -->\n")
        _, end, after = rest.partition(f"<!-- end of {mark} -->\n")
        page = "".join([before, start, *(f"{line}\n" for line in lines), end, after])
    return page


def picture() -> Iterator[str]:
    """List the packages in rows."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    layers = project["tool"]["importlinter"]["contracts"][0]["layers"]
    rows = [[room.strip() for room in layer.split("|")] for layer in layers]
    lines = [[f"{room:<15} {summary(source(room))}" for room in row] for row in rows]
    yield "```text"
    yield from "\n\n".join("\n".join(row) for row in lines).splitlines()
    yield "```"


def folders() -> Iterator[str]:
    """List the folders inside the packages, with what they are for."""
    for init in sorted(PACKAGE.glob("*/**/__init__.py")):
        if init.parent.parent != PACKAGE:
            yield f"* `{init.parent.relative_to(PACKAGE)}/`: {summary(init)}"


def modules_page() -> str:
    """List the modules of each folder, what they are for, and what they touch."""
    lines = ["# Modules", "", "In brackets: Zenoh, the clock, the log or files, if imported."]
    for init in sorted(PACKAGE.rglob("__init__.py")):
        folder = init.parent.relative_to(PACKAGE.parent)
        lines += ["", f"## {folder}", "", summary(init), ""]
        for file in sorted(init.parent.glob("[!_]*.py")):
            means = f" *({', '.join(touched(file))})*" if touched(file) else ""
            lines.append(f"* `{file.name}`: {summary(file)}{means}")
    return "\n".join(lines) + "\n"


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
