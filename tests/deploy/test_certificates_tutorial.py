"""The tutorial about certificates, line by line as it is printed; only the port is another."""

import json
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from clustermcl.runtime.settings_file import load_settings
from tests.integration.free_port import free_port
from tests.integration.processes import RunningProcess
from tests.integration.security.certificates import require_openssl
from tests.integration.system.commands import SMALL_FILTER
from tests.integration.waiting import wait_until

REPOSITORY = Path(__file__).parents[2]
PAGE = (REPOSITORY / "docs" / "tutorials" / "two-machines.md").read_text()
MAKE, START, ASK = re.findall(r"```bash\n(.*?)```", PAGE, re.DOTALL)[-3:]


def argv(line: str) -> list[str]:
    """A line as its process is started, without its comment."""
    name, *words = shlex.split(line, comments=True)
    return [sys.executable, *(["-I", "-m", "clustermcl"] if name == "clustermcl" else []), *words]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    require_openssl()
    folder = tmp_path_factory.mktemp("tutorial")
    shutil.copytree(REPOSITORY / "deploy", folder / "deploy")
    endpoint = f"tls/localhost:{free_port()}"
    text = MAKE.replace("certificates.sh router", f"certificates.sh --router {endpoint} router")
    assert "--listen tls/localhost:7447" in text, "on one machine"
    text = text.replace("tls/localhost:7447", endpoint)
    text = text.replace("python ", f"{shlex.quote(sys.executable)} ")
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", text],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert "worker-1: good until" in done.stdout
    return folder


class System:
    """All processes of the page, in the folder of the certificates; ended with the stack."""

    def __init__(self, folder: Path, ended: ExitStack) -> None:
        self.folder, self._ended, self._started = folder, ended, count()
        *_, self.coordinator = [self.start(line) for line in START.splitlines()]

    def start(self, line: str) -> RunningProcess:
        """Start a process; a coordinator keeps no state on disk, that others could read there."""
        small = [] if "router" in line else [*SMALL_FILTER, "--set", "coordinator.state_folder=off"]
        name = str(next(self._started))
        process = RunningProcess([*argv(line), *small], self.folder, name, cwd=self.folder)
        self._ended.callback(process.kill)
        return process

    def typed(self, line: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            argv(line), cwd=self.folder, capture_output=True, text=True, timeout=60, check=False
        )

    def asked(self, line: str) -> dict[str, Any]:
        """The answer to a query; empty without one."""
        return dict(json.loads(self.typed(f"{line} --json").stdout or "{}"))


@pytest.fixture
def system(folder: Path) -> Iterator[System]:
    with ExitStack() as ended:
        yield System(folder, ended)


@pytest.mark.timeout(180)
def test_the_tutorial_holds_as_it_is_typed_and_a_standby_takes_over_with_the_belief(
    system: System,
) -> None:
    look, refused, allowed, without = (line.partition(" #")[0].strip() for line in ASK.splitlines())
    status, places = look.replace("pose", "status"), look.replace("pose", "hypotheses")
    wait_until(lambda: "worker-1-0" in system.asked(status).get("workers", {}))
    wait_until(lambda: system.asked(places).get("hypotheses"))
    set_pose = refused.replace("relocalize", "set-pose 1 2 0")
    for line in (refused, set_pose, look.replace("viewer", "worker-1")):
        denied = system.typed(line)
        assert denied.returncode == 3
        assert re.search(r"certificates/.*\.pem may not ask for '.*: its role is", denied.stderr)
        assert denied.stderr.count("\n") == 1
    router = load_settings(system.folder / "certificates" / "viewer.toml", ()).zenoh.router
    without += f" --router {router.replace('tls/', 'tcp/')} --set zenoh.connect_timeout_s=0.5"
    answer = system.typed(without)
    assert answer.returncode == 3
    assert "the router there has TLS: set zenoh.router = tls/... and a certificate" in answer.stderr

    standby = system.start(START.splitlines()[-1] + " --name standby --standby")
    standby.wait_for("standing by")
    before = system.asked(status)
    wait_until(lambda: system.asked(places).get("step", 0) > 60)  # the first search is over
    wait_until(lambda: oldest_steps(system.asked(places)) > 10)
    system.coordinator.kill()
    wait_until(lambda: system.asked(status).get("term", 0) > before["term"])
    wait_until(lambda: system.asked(places).get("hypotheses"))
    assert oldest_steps(system.asked(places)) > 10, "it continues with the same places"
    assert system.typed(allowed).returncode == 0


def oldest_steps(answer: dict[str, Any]) -> int:
    """Age of the oldest place [steps]; 0 without any."""
    return max((place["age_steps"] for place in answer.get("hypotheses", ())), default=0)
