"""Reads YAML text as ROS does: 1e-3 is a number.

Aliases are refused: with them a few lines can expand beyond any memory. No map needs one, and ROS
parameter files cannot have them.
"""

import re
from pathlib import Path
from typing import Any

import yaml

from clustermcl.protocol.errors import InputFileError


class _AliasError(yaml.MarkedYAMLError):
    pass


class _Loader(yaml.SafeLoader):
    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            problem = "YAML aliases (*) are not read: write the value out"
            raise _AliasError(problem=problem, problem_mark=mark)
        return super().compose_node(parent, index)


# YAML 1.1 has text here unless there are a point and a sign: 1.0e-3.
_EXPONENT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$")
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", _EXPONENT, list("-+.0123456789"))


def yaml_of(content: bytes, path: Path, error: type[InputFileError]) -> tuple[Any, dict[str, int]]:
    """Return the value of a YAML text, and the line of each key if it is a mapping.

    Raises:
        InputFileError: of the type `error`; the text of `path` is not YAML, or has aliases.
    """
    try:
        loader = _Loader(content)
        node = loader.get_single_node()
        keys = node.value if isinstance(node, yaml.MappingNode) else ()
        lines = {str(key.value): key.start_mark.line + 1 for key, _ in keys}
        return (None if node is None else loader.construct_document(node)), lines
    except Exception as broken:  # of a tagged or endless number the library raises anything
        mark = getattr(broken, "problem_mark", None)
        problem = getattr(broken, "problem", None) or " ".join(str(broken).split())
        if not isinstance(broken, _AliasError):
            problem = f"not YAML: {problem}"
        raise error(path, problem, line=mark.line + 1 if mark else None) from broken
