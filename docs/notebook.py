"""Runs docs/tutorials/notebook.ipynb, and makes the page of it.

    python docs/notebook.py      runs it, and keeps what it shows in the file

Needs the group `docs`.
"""

import base64
import tempfile
from pathlib import Path
from typing import Any

import nbformat

NOTEBOOK = Path(__file__).parent / "tutorials" / "notebook.ipynb"
PAGE = "tutorials/notebook.md"


def kept() -> Any:
    """The notebook with the outputs in the file."""
    return nbformat.read(NOTEBOOK, as_version=4)


def executed() -> Any:
    """The notebook after all its cells have run, in a folder of its own.

    Raises:
        CellExecutionError: a cell has failed.
    """
    from nbclient import NotebookClient  # noqa: PLC0415 - the site needs the page alone

    notebook = kept()
    with tempfile.TemporaryDirectory() as folder:
        context = {"metadata": {"path": folder}}
        NotebookClient(notebook, timeout=300, record_timing=False, resources=context).execute()
    return notebook


def page() -> tuple[str, dict[str, bytes]]:
    """The notebook as Markdown, and its pictures by their paths in the site."""
    lines: list[str] = []
    pictures: dict[str, bytes] = {}
    for number, cell in enumerate(kept().cells):
        if cell.cell_type == "markdown":
            lines += [cell.source, ""]
            continue
        lines += ["```python", cell.source, "```", ""]
        for output in cell.outputs:
            data = output.get("data", {})
            if "image/png" in data:
                name = f"notebook-{number}.png"
                pictures[f"tutorials/{name}"] = base64.b64decode(data["image/png"])
                lines += [f"![What the cell above shows]({name})", ""]
            elif text := output.get("text") or data.get("text/plain"):
                lines += ["```text", text.rstrip(), "```", ""]
    return "\n".join(lines), pictures


if __name__ == "__main__":
    nbformat.write(executed(), NOTEBOOK)
