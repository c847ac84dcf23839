"""The tutorial about certificates, line by line as it is printed; only the port is another."""

import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.integration.free_port import free_port
from tests.integration.processes import RunningProcess
from tests.integration.security.certificates import require_openssl
from tests.integration.system.commands import SMALL_FILTER
from tests.integration.waiting import wait_until

REPOSITORY = Path(__file__).parents[2]
PAGE = (REPOSITORY / "docs" / "tutorials" / "certificates.md").read_text()
MAKE, START, ASK = re.findall(r"```bash\n(.*?)```", PAGE, re.DOTALL)


def argv(line: str) -> list[str]:
    """A line as its process is started, without its comment."""
    name, *words = shlex.split(line, comments=True)
    return [
        sys.executable,
        *({"python": [], "clustermcl": ["-I", "-m", "clustermcl"]}[name]),
        *words,
    ]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the certificates have been made."""
    require_openssl()
    folder = tmp_path_factory.mktemp("tutorial")
    shutil.copytree(REPOSITORY / "deploy", folder / "deploy")
    endpoint = f"tls/localhost:{free_port()}"
    text = MAKE.replace("certificates.sh router", f"certificates.sh --router {endpoint} router")
    text = text.replace("secure_router ", f"secure_router --listen {endpoint} ")
    text = text.replace("python ", f"{shlex.quote(sys.executable)} ")
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", text],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert "worker-1: good until" in done.stdout
    return folder


@pytest.fixture(scope="module")
def system(folder: Path) -> Iterator[Path]:
    """The folder, with all processes running in it."""
    with ExitStack() as ended:
        for number, line in enumerate(START.splitlines()):
            small = [] if "router" in line else SMALL_FILTER
            process = RunningProcess([*argv(line), *small], folder, str(number), cwd=folder)
            ended.callback(process.kill)
        yield folder


def typed(folder: Path, line: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        argv(line), cwd=folder, capture_output=True, text=True, timeout=60, check=False
    )


@pytest.mark.timeout(180)
def test_the_tutorial_holds_as_it_is_typed(system: Path) -> None:
    look, refused, allowed, nobody = ASK.splitlines()
    status = look.replace("pose", "status")
    wait_until(lambda: "worker-1-0" in typed(system, status).stdout, deadline_s=90.0)
    wait_until(lambda: "with probability" in typed(system, look).stdout, deadline_s=60.0)
    denied = typed(system, refused)
    assert denied.returncode == 3
    assert "does this certificate's role allow it?" in denied.stderr
    assert typed(system, allowed).returncode == 0
    assert typed(system, nobody + " --set zenoh.connect_timeout_s=0.5").returncode == 3
