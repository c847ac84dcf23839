import importlib.util
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml
import zenoh

from clustermcl.link.session import MANY_LINKS, VARIABLE
from clustermcl.runtime.settings_file import load_settings

DEPLOY = Path(__file__).parents[2] / "deploy"
PLAIN, SECURE = DEPLOY / "compose.yaml", DEPLOY / "compose.secure.yaml"


class _Compose(yaml.SafeLoader):
    """Knows compose's tag for what replaces and does not add."""


_Compose.add_constructor("!override", lambda loader, node: loader.construct_sequence(node))


def services(file: Path) -> dict[str, Any]:
    return dict(yaml.load(file.read_text(), Loader=_Compose)["services"])


@pytest.mark.parametrize("file", [PLAIN, SECURE], ids=["plain", "secure"])
def test_every_container_runs_a_process_of_ours_with_settings_that_are_there(file: Path) -> None:
    ours = {name: made["command"] for name, made in services(file).items() if name != "router"}
    assert {"bridge", "coordinator", "standby-coordinator", "worker"} == set(ours)
    for module, *words in ours.values():
        assert importlib.util.find_spec(f"{module}.__main__") is not None
        assert (DEPLOY / Path(words[words.index("--settings") + 1]).name).is_file()
        assignments = [words[at + 1] for at, word in enumerate(words) if word == "--set"]
        load_settings(DEPLOY / "settings.toml", assignments)


def test_the_router_is_the_official_one_of_the_version_that_is_tested() -> None:
    lock = (DEPLOY.parent / "locks/requirements.lock").read_text()
    (version,) = re.findall(r"^eclipse-zenoh==([\d.]+)", lock, re.MULTILINE)
    router = services(PLAIN)["router"]
    assert router["image"] == f"docker.io/eclipse/zenoh:{version}"
    assert router["environment"][VARIABLE] == MANY_LINKS
    zenoh.Config.from_file(str(DEPLOY / Path(router["command"][-1]).name))


def compose_command() -> list[str]:
    """Docker's compose, of the second generation; its first knows another format."""
    for command in (["docker", "compose"], ["docker-compose"]):
        if shutil.which(command[0]):
            ran = subprocess.run([*command, "version"], capture_output=True, text=True, check=False)
            if ran.returncode == 0 and re.search(r"\bv?[2-9]\.\d+", ran.stdout):
                return command
    pytest.skip("docker compose (v2) is not installed")


@pytest.mark.parametrize("files", [[PLAIN], [PLAIN, SECURE]], ids=["plain", "secure"])
def test_compose_itself_reads_the_files(files: list[Path]) -> None:
    words = [word for file in files for word in ("--file", str(file))]
    ran = subprocess.run(
        [*compose_command(), *words, "--profile", "standby", "config", "--quiet"],
        env={"PATH": os.environ["PATH"]}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (ran.returncode, ran.stderr) == (0, "")
