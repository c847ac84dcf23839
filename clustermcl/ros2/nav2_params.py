"""Read AMCL's parameters of a `nav2_params.yaml` as settings."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from clustermcl.protocol.errors import InputFileError
from clustermcl.ros2.parameter_table import PARAMETERS, ROS1_NAMES, Value
from clustermcl.runtime.compressed import read_decompressed
from clustermcl.runtime.settings_file import MAX_FILE_BYTES
from clustermcl.runtime.yaml_text import yaml_of

_NODE = "amcl"
_PARAMETERS = "ros__parameters"
_ANY_NODE = ("/**", "/*")


def read_nav2_params(path: Path) -> tuple[dict[str, Value], list[str]]:
    """Read the parameters of the node `amcl` as settings, with notes as `settings_of`.

    They are under ``NODE: ros__parameters:``, also in a namespace, or for all nodes under ``/**``
    or ``/*``. As in ROS, of two values the later one counts, whichever is more general.

    Raises:
        InputFileError: the file is unreadable or malformed, or has no parameters of that node.
    """
    try:
        content = read_decompressed(path, InputFileError, MAX_FILE_BYTES)
        tree, _ = yaml_of(content, path, InputFileError)
        if not isinstance(tree, dict):
            raise ValueError("not a parameter file: it is not a mapping")
        return settings_of(_of_node(tree, path))
    except ValueError as problem:
        raise InputFileError(path, str(problem)) from None


def settings_of(found: Mapping[str, Any]) -> tuple[dict[str, Value], list[str]]:
    """Convert parameters to settings, by their dotted names, and notes.

    A note is a line on a parameter that has no effect here, or another one than in nav2, unless it
    has nav2's default.

    Raises:
        ValueError: nav2 does not accept a value.
    """
    values: dict[str, Value] = {}
    notes = []
    for written, value in found.items():
        name = ROS1_NAMES.get(written, written)
        if name != written:
            if name in found:
                notes.append(f"{written} of ROS 1 has no effect: {name} is given too")
                continue
            notes.append(f"{written} of ROS 1 is read as {name}")
        parameter = PARAMETERS.get(name)
        if parameter is None:
            notes.append(f"{name} has no effect: AMCL has no such parameter")
            continue
        if not parameter.setting:
            if value != parameter.default:
                notes.append(f"{name} has no effect: {parameter.reason}")
            continue
        try:
            setting = parameter.converted(value)
        except ValueError as problem:
            raise ValueError(f"{name} = {value!r}: {problem}") from None
        if setting is not None:
            values[parameter.setting] = setting
    return values, notes


def _of_node(tree: dict[Any, Any], path: Path) -> dict[str, Any]:
    nodes = list(_nodes(tree))
    # rclcpp's parameter_map_from: all that match the node, in the order of the file.
    found = [each for node, each in nodes if node in _ANY_NODE or node.rpartition("/")[2] == _NODE]
    if not found:
        others = ", ".join(sorted({node for node, _ in nodes})) or "none"
        raise InputFileError(path, f"no parameters of a node {_NODE!r}; it has those of: {others}")
    return {name: value for each in found for name, value in _flat(each)}


def _nodes(tree: dict[Any, Any], node: str = "") -> Iterator[tuple[str, dict[Any, Any]]]:
    """Yield the name of the node of each set of parameters, and the set."""
    for name, value in tree.items():
        if isinstance(value, dict) and name == _PARAMETERS and node:
            yield node, value
        elif isinstance(value, dict) and name != _PARAMETERS:
            yield from _nodes(value, str(name))


def _flat(parameters: dict[Any, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in parameters.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value
