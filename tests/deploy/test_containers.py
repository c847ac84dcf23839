"""The compose files and the image file."""

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

from process_runtime.settings_file import load_settings
from zenoh_link.threads import ROUTER, VARIABLE

DEPLOY = Path(__file__).parents[2] / "deploy"
PLAIN, SECURE = DEPLOY / "compose.yaml", DEPLOY / "compose.secure.yaml"


class _Compose(yaml.SafeLoader):
    """Knows compose's tag for what replaces and does not add."""


_Compose.add_constructor("!override", lambda loader, node: loader.construct_sequence(node))


def services(file: Path) -> dict[str, Any]:
    return dict(yaml.load(file.read_text(), Loader=_Compose)["services"])


def processes(file: Path) -> dict[str, list[str]]:
    """Commands of our own processes; the router is the official one."""
    return {name: made["command"] for name, made in services(file).items() if name != "router"}


@pytest.mark.parametrize("file", [PLAIN, SECURE], ids=["plain", "secure"])
def test_every_container_runs_a_process_of_ours_with_settings_that_are_there(file: Path) -> None:
    assert {"bridge", "coordinator", "standby-coordinator", "worker"} == set(processes(file))
    for module, *words in processes(file).values():
        assert importlib.util.find_spec(f"{module}.__main__") is not None
        assert (DEPLOY / Path(words[words.index("--settings") + 1]).name).is_file()
        assignments = [words[at + 1] for at, word in enumerate(words) if word == "--set"]
        load_settings(DEPLOY / "settings.toml", assignments)


def test_the_router_is_the_official_one_of_the_version_that_is_tested() -> None:
    image = services(PLAIN)["router"]["image"]
    assert image == f"docker.io/eclipse/zenoh:{zenoh_version()}"
    assert services(PLAIN)["router"]["command"] == ["--config", "/etc/clustermcl/router.json5"]
    assert services(PLAIN)["router"]["environment"][VARIABLE] == ROUTER
    zenoh.Config.from_file(str(DEPLOY / "router.json5"))


def test_the_pages_tell_the_official_router_how_many_threads_ours_has() -> None:
    files = [DEPLOY / "router.json5", DEPLOY / "systemd" / "clustermcl-router.service"]
    for file in (*files, DEPLOY.parent / "docs" / "operations.md"):
        assert ROUTER in file.read_text(), file


def zenoh_version() -> str:
    lock = (DEPLOY.parent / "requirements.lock").read_text()
    found = re.search(r"^eclipse-zenoh==([\d.]+)", lock, re.MULTILINE)
    assert found is not None
    return found[1]


def test_no_container_may_more_than_it_must() -> None:
    for name, service in services(PLAIN).items():
        assert service["cap_drop"] == ["ALL"], name
        assert service["read_only"] is True, name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        assert "privileged" not in service, name


def test_without_certificates_nothing_is_open_to_other_machines() -> None:
    for service in services(PLAIN).values():
        for port in service.get("ports", []):
            assert port.startswith("127.0.0.1:")


def test_every_container_has_its_own_key_and_no_other() -> None:
    roles = {"router": "router", "bridge": "bridge", "worker": "worker-1"}
    for name, service in services(SECURE).items():
        sources = [s if isinstance(s, str) else s["source"] for s in service["secrets"]]
        keys = [source for source in sources if source.endswith(".key")]
        assert keys == [f"{roles.get(name, 'coordinator')}.key"]
    secrets = yaml.load(SECURE.read_text(), Loader=_Compose)["secrets"]
    asked = {
        s if isinstance(s, str) else s["source"]
        for service in services(SECURE).values()
        for s in service["secrets"]
    }
    assert asked == set(secrets)


def test_keys_never_get_into_the_image_or_into_git() -> None:
    assert "**/*.key" in (DEPLOY / "Containerfile.dockerignore").read_text().split()
    assert "*.key" in (DEPLOY.parent / ".gitignore").read_text().split()


def test_the_image_runs_as_the_user_whose_number_the_pages_name() -> None:
    image = (DEPLOY / "Containerfile").read_text()
    assert "USER 10001:10001" in image
    assert "--uid 10001" in image
    assert "chown 10001" in SECURE.read_text()


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
        env={"PATH": os.environ["PATH"]},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (ran.returncode, ran.stderr) == (0, "")
