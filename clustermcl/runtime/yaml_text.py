"""Reads YAML text as ROS does: 1e-3 is a number, and a key is the text that is written.

Aliases are refused: with them a few lines can expand beyond any memory. No map needs one, and ROS
parameter files cannot have them.
"""

import re
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from clustermcl.protocol.errors import InputFileError, printable


class _RefusedError(yaml.MarkedYAMLError):
    pass


class _Loader(yaml.SafeLoader):
    is_unique = False
    """Whether a key that is in a mapping twice is refused; if not, the later value counts."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            problem = "YAML aliases (*) are not read: write the value out"
            raise _RefusedError(problem=problem, problem_mark=mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        values = dict[Hashable, Any]()
        for key, value in node.value:
            name = str(key.value)
            if self.is_unique and name in values:
                problem = f"{printable(name)!r} is there twice"
                raise _RefusedError(problem=problem, problem_mark=key.start_mark)
            values[name] = self.construct_object(value, deep)
        return values


# YAML 1.1 has text here unless there are a point and a sign: 1.0e-3.
_EXPONENT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$")
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", _EXPONENT, list("-+.0123456789"))


def yaml_of(
    content: bytes, path: Path, error: type[InputFileError], *, is_unique: bool = False
) -> tuple[Any, dict[str, int]]:
    """Return the value of a YAML text, and the line of each key if it is a mapping.

    Raises:
        InputFileError: of the type `error`; the text of `path` is not YAML, has aliases, or, if
            `is_unique`, has a key twice.
    """
    try:
        loader = _Loader(content)
        loader.is_unique = is_unique
        node = loader.get_single_node()
        keys = node.value if isinstance(node, yaml.MappingNode) else ()
        lines = {str(key.value): key.start_mark.line + 1 for key, _ in keys}
        return (None if node is None else loader.construct_document(node)), lines
    except Exception as broken:  # of a tagged or endless number the library raises anything
        mark = getattr(broken, "problem_mark", None)
        problem = getattr(broken, "problem", None) or " ".join(str(broken).split())
        if not isinstance(broken, _RefusedError):
            problem = f"not YAML: {problem}"
        raise error(path, problem, line=mark.line + 1 if mark else None) from broken
