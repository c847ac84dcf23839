import re
import tomllib
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[3]
LOCK = (REPOSITORY / "requirements.lock").read_text()
BROWSER_LOCK = (REPOSITORY / "requirements-browser.lock").read_text()
RUN_LOCK = (REPOSITORY / "requirements-run.lock").read_text()
DOCS_LOCK = (REPOSITORY / "requirements-docs.lock").read_text()
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())


def normal(requirement: str) -> str:
    """A package's name without version, spelt as indices spell it."""
    name = re.match(r"[\w.-]+", requirement)
    assert name is not None
    return re.sub(r"[-_.]+", "-", name[0]).lower()


def pinned(lock: str) -> dict[str, tuple[str, frozenset[str]]]:
    """Version and hashes of each package in a lock."""
    return {
        name: (version, frozenset(re.findall("sha256:([0-9a-f]{64})", rest)))
        for name, version, rest in re.findall(
            r"^([a-z0-9-]+)==([\w.]+)((?: \\\n    --hash=\S+)+)$", lock, re.MULTILINE
        )
    }


def test_the_lock_holds_all_that_the_project_and_its_development_need() -> None:
    locked = set(re.findall(r"^([a-z0-9-]+)==", LOCK, re.MULTILINE))
    project = PROJECT["project"]
    asked = [*project["dependencies"], *project["optional-dependencies"]["dev"]]
    asked += PROJECT["build-system"]["requires"]  # both are installed without build isolation
    assert {normal(requirement) for requirement in asked} <= locked


def test_every_package_in_the_lock_has_one_exact_version_and_hashes() -> None:
    packages = re.split(r"\n(?=[a-z0-9])", LOCK.strip())
    for package in packages:
        assert re.match(r"[a-z0-9-]+==[\w.]+ \\\n    --hash=sha256:[0-9a-f]{64}", package), package


def test_the_browser_lock_has_hashes_and_changes_no_other_package() -> None:
    browser, development = pinned(BROWSER_LOCK), pinned(LOCK)
    assert {normal(one) for one in PROJECT["project"]["optional-dependencies"]["browser"]} <= set(
        browser
    )
    assert len(browser) == BROWSER_LOCK.count("==")
    assert all(hashes for _, hashes in browser.values())
    for name in browser.keys() & development.keys():
        assert browser[name][0] == development[name][0], name


@pytest.mark.parametrize("release", ["jazzy", "kilted"])
def test_the_ros_lock_has_hashes(release: str) -> None:
    text = (REPOSITORY / f"requirements-ros-{release}.lock").read_text()
    packages = pinned(text)
    assert {"ros-rclpy", "mcap-ros2-support"} <= set(packages)
    assert len(packages) == text.count("==")
    assert all(hashes for _, hashes in packages.values())


def test_the_lock_names_no_package_index() -> None:
    assert not re.search(r"http|file:|^-|/", LOCK, re.MULTILINE)


def test_every_top_level_package_is_shipped_typed_checked_and_layered() -> None:
    packages = {folder.parent.name for folder in REPOSITORY.glob("*/__init__.py")} - {"tests"}
    tool = PROJECT["tool"]
    assert set(tool["hatch"]["build"]["targets"]["wheel"]["packages"]) == packages
    assert set(tool["mypy"]["packages"]) == packages | {"benchmarks", "tests"}
    assert set(tool["importlinter"]["root_packages"]) == packages
    layers = " ".join(tool["importlinter"]["contracts"][0]["layers"])
    assert set(layers.replace("|", " ").split()) == packages


def test_the_runtime_lock_pins_the_tested_versions() -> None:
    run, tested = pinned(RUN_LOCK), pinned(LOCK)
    assert run
    assert {name: tested[name] for name in run} == run


def test_the_runtime_lock_has_all_dependencies_and_no_development_tools() -> None:
    project = PROJECT["project"]
    extras = project["optional-dependencies"]
    run = [*project["dependencies"], *extras["metrics"], *extras["ros2"]]
    needed = {normal(requirement) for requirement in run}
    tools = {normal(requirement) for requirement in project["optional-dependencies"]["dev"]}
    assert needed <= pinned(RUN_LOCK).keys()
    assert not (tools - needed) & pinned(RUN_LOCK).keys()


def test_the_lock_of_the_site_has_the_tested_versions_and_its_own_packages() -> None:
    docs, tested = pinned(DOCS_LOCK), pinned(LOCK)
    assert {name: tested[name] for name in docs.keys() & tested.keys()} == {
        name: docs[name] for name in docs.keys() & tested.keys()
    }
    project = PROJECT["project"]
    asked = [*project["dependencies"], *project["optional-dependencies"]["docs"]]
    assert {normal(requirement) for requirement in asked} <= docs.keys()
    assert "--hash" in DOCS_LOCK
    assert not re.search(r"http|file:", DOCS_LOCK)
