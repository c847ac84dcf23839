"""The pages of the reference, made from the code: settings, commands, messages, the client.

python docs/reference.py reference/settings.md        prints one
"""

import ast
import importlib
import inspect
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

from typer.testing import CliRunner

import clustermcl
from clustermcl.commands.command import COMMANDS, app
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.message import Message
from clustermcl.runtime.settings_table import TABLE

DOCS = Path(__file__).parent
MESSAGES = {
    "steps": "From robots, recordings and the bridge",
    "work": "Between coordinator and workers",
    "answers": "Beliefs, answers and commands",
    "job_events": "What began and ended",
    "health": "How each process is",
}
"""Modules of `protocol` that define messages."""


def settings_page() -> str:
    """Every setting: default, what is accepted, meaning."""
    lines = [
        "# Settings",
        "",
        "One TOML file for all processes (`--settings FILE`), and `--set section.key=value` on any "
        "command line. `clustermcl settings` prints this as a file to begin with.",
    ]
    section = None
    for name, info in TABLE.items():
        if (of := name.rpartition(".")[0]) != section:
            section = of
            lines += ["", f"## {section}" if section else "", ""]
            lines += ["| setting | default | accepted | meaning |", "| --- | --- | --- | --- |"]
        default = f'"{info.default}"' if isinstance(info.default, str) else str(info.default)
        cells = (f"`{name}`", f"`{default}`", info.expected, info.meaning)
        lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    return "\n".join(lines) + "\n"


def commands_page() -> str:
    """What each command says of itself."""
    lines = ["# Commands", "", "What `--help` says.", ""]
    for name in ("", *sorted(name for group in COMMANDS.values() for name in group)):
        words = [name] if name else []
        result = CliRunner().invoke(
            app, [*words, "--help"], prog_name="clustermcl", terminal_width=96
        )
        lines += [f"## clustermcl {name}".rstrip(), "", "```text", result.output.strip(), "```", ""]
    return "\n".join(lines)


def library_page() -> str:
    """The library, for mkdocstrings to fill in."""
    about = "What `clustermcl` exports, but for the [client](client.md)."
    names = {*clustermcl.__all__} - {"Client", "ClusterMCL"}
    others = sorted(names, key=lambda name: (name.endswith("Error"), name.lower()))
    return _members("The library", about, ["ClusterMCL", *others])


def client_page() -> str:
    """The Python client, for mkdocstrings to fill in."""
    about = (
        "What answers hold: [messages](messages.md). Asking with it: [From Python](../library.md)."
    )
    return _members("The Python client", about, ["Client"])


def _members(title: str, about: str, names: list[str]) -> str:
    return "\n\n".join([f"# {title}", about, *(f"::: clustermcl.{name}" for name in names)])


def messages_page() -> str:
    """Every message with its fields."""
    lines = ["# Messages", "", "Keys, rates and the rules of evolution: [On the wire](../wire.md)."]
    for module, title in MESSAGES.items():
        lines += ["", f"## {title}"]
        loaded = importlib.import_module(f"clustermcl.protocol.{module}")
        for name, kind in structures(loaded):
            schema = kind.__struct_config__.tag
            tag = f" `{schema}`" if issubclass(kind, Message) and isinstance(schema, str) else ""
            lines += ["", f"### {name}{tag}", "", *_docstring(inspect.getdoc(kind) or "")]
            lines += ["", "| field | type | what it is |", "| --- | --- | --- |"]
            lines += [
                f"| `{field}` | `{type_}` | {meaning} |"
                for field, type_, meaning in fields(loaded, name)
            ]
    return "\n".join(lines) + "\n"


def structures(module: ModuleType) -> Iterator[tuple[str, type[Message]]]:
    """The structures that a module defines, in its order."""
    for name, kind in vars(module).items():
        own = inspect.isclass(kind) and kind.__module__ == module.__name__
        if own and hasattr(kind, "__struct_fields__"):
            yield name, kind


def fields(module: ModuleType, name: str) -> Iterator[tuple[str, str, str]]:
    """Name, type and docstring of each field of one structure, as its source has them."""
    tree = ast.parse(inspect.getsource(module))
    body = next(n.body for n in tree.body if isinstance(n, ast.ClassDef) and n.name == name)
    for index, node in enumerate(body):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            after = body[index + 1] if index + 1 < len(body) else None
            meaning = ""
            if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
                meaning = " ".join(str(after.value.value).split())
            type_ = ast.unparse(node.annotation)
            if type_.startswith("ClassVar"):
                continue
            yield node.target.id, type_.replace("|", "\\|"), meaning.replace("|", "\\|")


def causes_page() -> str:
    """Every cause of dropped data, with its meaning."""
    lines = [
        "# Causes",
        "",
        "What to do: [Operations](../operations.md#dropped-or-refused-data).",
        "",
    ]
    lines += ["| cause | means |", "| --- | --- |"]
    return "\n".join([*lines, *(f"| `{cause}` | {cause.means} |" for cause in Cause)]) + "\n"


def _docstring(text: str) -> Iterator[str]:
    """Sections of a docstring as headings and lists."""
    for block in text.split("\n\n"):
        head, _, rest = block.partition("\n")
        if head in ("Args:", "Returns:", "Raises:", "References:"):
            yield from (f"**{head.removesuffix(':')}**", "")
            entries = textwrap.dedent(rest).replace("\n    ", " ").splitlines()
            yield from (f"* {entry}" for entry in entries)
        else:
            yield block.replace("``", "`")
        yield ""


PAGES = {
    "reference/settings.md": settings_page,
    "reference/commands.md": commands_page,
    "reference/library.md": library_page,
    "reference/client.md": client_page,
    "reference/messages.md": messages_page,
    "reference/causes.md": causes_page,
}

if __name__ == "__main__":
    sys.stdout.write(PAGES[sys.argv[1]]())
