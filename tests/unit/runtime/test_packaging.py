import re
import tomllib
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[3]
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())
LOCKS = {path.stem: path.read_text() for path in REPOSITORY.glob("locks/requirements*.lock")}


def normal(requirement: str) -> str:
    """A package's name without version, spelt as indices spell it."""
    name = re.match(r"[\w.-]+", requirement)
    assert name is not None
    return re.sub(r"[-_.]+", "-", name[0]).lower()


def pinned(lock: str) -> dict[str, tuple[str, frozenset[str]]]:
    return {
        name: (version, frozenset(re.findall("sha256:([0-9a-f]{64})", rest)))
        for name, version, rest in re.findall(
            r"^([a-z0-9-]+)==([\w.]+)((?: \\\n    --hash=\S+)+)$", lock, re.MULTILINE
        )
    }


def asked_for(*extras: str) -> set[str]:
    """The packages of the project, and of some of its extras and groups."""
    project = PROJECT["project"]
    asked = [*project["dependencies"]]
    for extra in extras:
        asked += (project["optional-dependencies"] | PROJECT["dependency-groups"])[extra]
    return {normal(requirement) for requirement in asked}


TESTED = pinned(LOCKS["requirements"])


@pytest.mark.parametrize(
    ("name", "extras"),
    [
        ("requirements", ["dev"]),
        ("requirements-browser", ["browser"]),
        ("requirements-run", ["metrics", "ros2"]),
        ("requirements-docs", ["docs"]),
    ],
)
def test_a_lock_has_all_that_is_needed_in_the_tested_versions(name: str, extras: list[str]) -> None:
    locked = pinned(LOCKS[name])
    needed = asked_for(*extras)
    if name == "requirements-browser":  # it is installed beside the tested packages
        needed -= asked_for()
    assert needed <= locked.keys()
    assert {one: version for one, (version, _) in locked.items() if one in TESTED} == {
        one: version for one, (version, _) in TESTED.items() if one in locked
    }


def test_the_runtime_lock_pins_the_tested_files_and_no_development_tools() -> None:
    run = pinned(LOCKS["requirements-run"])
    assert {name: TESTED[name] for name in run} == run
    assert not (asked_for("dev") - asked_for("metrics", "ros2")) & run.keys()
