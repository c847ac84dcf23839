"""A stock `nav2_params.yaml` as settings: AMCL's parameters by nav2's names and in its units."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from process_runtime.settings_file import content_of
from protocol.errors import InputFileError
from ros2_bridge.parameter_table import PARAMETERS, Value

_PARAMETERS = "ros__parameters"
_ANY_NODE = ("/**", "/*")
_SEPARATOR = "."


@dataclass(frozen=True)
class Nav2Params:
    """What became of a file.

    Args:
        values: settings by their dotted names.
        without_effect: parameters that mean nothing here, and why.
    """

    values: dict[str, Value]
    without_effect: dict[str, str]


def read_nav2_params(path: Path, node_name: str = "amcl") -> Nav2Params:
    """Read the parameters of one node; the others' are left alone.

    Args:
        path: the YAML file, as nav2 gets it: parameters below ``NODE: ros__parameters:``, perhaps
            below a namespace, or for all nodes below ``/**``.
        node_name: whose parameters.

    Raises:
        InputFileError: the file cannot be read, is no such file, or says nothing of that node.
    """
    found = dict(_flat(_of_node(_tree(path), node_name, path)))
    values: dict[str, Value] = {"ros2.enabled": True, "ros2.node_name": node_name}
    without_effect: dict[str, str] = {}
    for name, value in found.items():
        parameter = PARAMETERS.get(name)
        if parameter is None:
            without_effect[name] = "AMCL has no such parameter"
        elif not parameter.setting:
            without_effect[name] = parameter.reason
        else:
            if isinstance(value, bool) != isinstance(parameter.default, bool) or (
                isinstance(value, str) != isinstance(parameter.default, str)
            ):
                kind = type(parameter.default).__name__
                raise InputFileError(path, f"{name} = {value!r}: nav2 takes a {kind}")
            setting = parameter.to_setting(value)
            if setting is None:
                without_effect[name] = f"{value} leaves {parameter.setting} as it is"
            else:
                values[parameter.setting] = setting
    return Nav2Params(values, without_effect)


def _tree(path: Path) -> dict[Any, Any]:
    try:
        tree = yaml.safe_load(content_of(path))
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        problem = " ".join(str(error).split())
        raise InputFileError(path, f"not YAML: {problem}") from error
    if not isinstance(tree, dict):
        raise InputFileError(path, "no file of parameters: it is not a mapping")
    return tree


def _of_node(tree: dict[Any, Any], node_name: str, path: Path) -> dict[Any, Any]:
    """The parameters of a node; those for all nodes first, then its own."""
    found: dict[Any, Any] = {}
    own = False
    for where, parameters in sorted(_nodes(tree), key=lambda one: one[0][-1] not in _ANY_NODE):
        last = where[-1].rpartition("/")[2]
        if where[-1] in _ANY_NODE or last == node_name:
            found |= parameters
            own = own or last == node_name
    if not own:
        others = ", ".join(sorted({where[-1] for where, _ in _nodes(tree)})) or "none"
        problem = f"no parameters of a node {node_name!r}; it has those of: {others}"
        raise InputFileError(path, problem)
    return found


def _nodes(
    tree: dict[Any, Any], above: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], dict[Any, Any]]]:
    """Where each set of parameters stands, and the set."""
    for name, value in tree.items():
        if not isinstance(value, dict):
            continue
        if name == _PARAMETERS and above:
            yield above, value
        elif name != _PARAMETERS:
            yield from _nodes(value, (*above, str(name)))


def _flat(parameters: dict[Any, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Parameters in parameters by dotted names."""
    for name, value in parameters.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{above}{name}{_SEPARATOR}")
        else:
            yield f"{above}{name}", value
