import ast
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from clustermcl.protocol.errors import AlreadyRunningError, SettingsError

REPOSITORY = Path(__file__).parents[3]
ABSTRACT = {"ClusterMclError"}
"""Base classes, never raised themselves."""


def classes() -> Iterator[ast.ClassDef]:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())
    for package in project["tool"]["importlinter"]["root_packages"]:
        for file in (REPOSITORY / package).rglob("*.py"):
            tree = ast.parse(file.read_text())
            yield from (node for node in ast.walk(tree) if isinstance(node, ast.ClassDef))


def errors() -> dict[str, ast.ClassDef]:
    """All errors that a person can cause, by name."""
    by_name = {made.name: made for made in classes()}
    found = {"ClusterMclError": by_name["ClusterMclError"]}
    while more := {n: c for n, c in by_name.items() if n not in found and found.keys() & bases(c)}:
        found |= more
    return found


def bases(made: ast.ClassDef) -> set[str]:
    return {base.id for base in made.bases if isinstance(base, ast.Name)}


def facts(name: str, known: dict[str, ast.ClassDef]) -> set[str]:
    """Attributes that the constructor sets, its own or inherited."""
    made = known[name]
    for function in made.body:
        if isinstance(function, ast.FunctionDef) and function.name == "__init__":
            return {
                node.attr
                for node in ast.walk(function)
                if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)
            }
    inherited = [facts(base, known) for base in bases(made) & known.keys()]
    return inherited[0] if inherited else set()


ERRORS = errors()


@pytest.mark.parametrize("name", sorted(ERRORS.keys() - ABSTRACT))
def test_every_error_has_its_facts_as_attributes(name: str) -> None:
    assert facts(name, ERRORS)


def test_a_refused_setting_names_its_key_and_where_it_was_set() -> None:
    error = SettingsError(key="seed", problem="seed = -1: expected >= 0", where="robot.toml")
    assert str(error) == "robot.toml: seed = -1: expected >= 0"
    assert (error.key, error.where) == ("seed", "robot.toml")


def test_an_already_running_error_has_its_facts_as_attributes() -> None:
    second = AlreadyRunningError(
        what="a coordinator", robot="r1", endpoint="tcp/h:7447", advice="stop it"
    )
    assert str(second) == "robot 'r1' already has a coordinator at tcp/h:7447: stop it"
    router = AlreadyRunningError(what="a router", endpoint="tcp/h:7447", advice="stop it")
    assert str(router) == "tcp/h:7447 is in use: a router already listens there; stop it"
    assert (second.robot, router.robot) == ("r1", None)
