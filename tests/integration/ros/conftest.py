"""AMCL's node as `colcon build` installs it, and robots; each test has a domain of its own."""

import fcntl
import itertools
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from tests.integration.conftest import StartProcess
from tests.integration.processes import RunningProcess

if TYPE_CHECKING:
    from tests.integration.ros.robot import Drive, Robot

ROOT = Path(__file__).parents[3]
RUNNING = "is running over rmw_"
TF_IN_NAMESPACE = ("-r", "/tf:=tf", "-r", "/tf_static:=tf_static")
DOMAINS = range(8, 100)
_used = itertools.count()

StartNode = Callable[..., RunningProcess]
OpenRobot = Callable[..., "Robot"]
StartDrive = Callable[..., "Drive"]


@pytest.fixture(scope="session")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder into which colcon installs the package, with this virtual environment active."""
    colcon = os.environ.get("COLCON") or shutil.which("colcon")
    if colcon is None:
        pytest.skip("no colcon: see .ci/run")
    workspace = tmp_path_factory.mktemp("workspace")
    (workspace / "src").mkdir()
    shutil.copytree(ROOT / "ros" / "clustermcl_ros", workspace / "src" / "clustermcl_ros")
    active = os.environ | {"VIRTUAL_ENV": sys.prefix}
    built = subprocess.run(
        [colcon, "build"], cwd=workspace, env=active, capture_output=True, text=True, check=False
    )
    assert built.returncode == 0, built.stdout + built.stderr
    return workspace / "install"


@pytest.fixture
def domain(worker_id: str) -> Iterator[int]:
    """A ROS domain that no other running test has, also of another run on this machine.

    It was not used just before, for killed processes stay in a graph for 20 s.
    """
    begin = 23 * int(worker_id.removeprefix("gw")) if worker_id.startswith("gw") else 0
    for _ in DOMAINS:
        number = DOMAINS[(begin + next(_used)) % len(DOMAINS)]
        file = Path(tempfile.gettempdir()) / f"clustermcl-ros-domain-{number}.lock"
        with file.open("w") as lock, suppress(BlockingIOError):
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield number
            return
    pytest.fail("all domains are in use")


@pytest.fixture
def start_node(
    installed: Path, domain: int, start_process: StartProcess, tmp_path: Path
) -> StartNode:
    """Starts AMCL's node as launch does: by the installed script, with ROS's arguments."""
    count = itertools.count()

    def start(
        *arguments: str,
        parameters: dict[str, Any] | None = None,
        file: str = "",
        expect: str = RUNNING,
    ) -> RunningProcess:
        if parameters:
            file = yaml.safe_dump({"/**": {"ros__parameters": parameters}})
        if file:
            path = tmp_path / f"parameters-{next(count)}.yaml"
            path.write_text(file)
            arguments = (*arguments, "--params-file", str(path))
        script = installed / "clustermcl_ros" / "lib" / "clustermcl_ros" / "amcl"
        words = [str(script), *(["--ros-args", *arguments] if arguments else [])]
        own = shlex.join([f"ROS_DOMAIN_ID={domain}", f"XDG_STATE_HOME={tmp_path}"])
        setup = shlex.quote(str(installed / "setup.bash"))
        command = f"source {setup} && export {own} && exec {shlex.join(words)}"
        process = start_process(["bash", "-c", command])
        if expect:
            process.wait_for(expect)
        return process

    return start


@pytest.fixture
def open_robot(domain: int) -> Iterator[OpenRobot]:
    """Makes robots; they live as long as the test."""
    from tests.integration.ros.robot import Robot  # noqa: PLC0415 - only where ROS is

    made: list[Robot] = []

    def robot(namespace: str = "", *, name: str = "robot") -> Robot:
        made.append(Robot(domain, namespace, name))
        return made[-1]

    yield robot
    for one in made:
        one.close()


@pytest.fixture
def start_drive(start_node: StartNode, open_robot: OpenRobot) -> StartDrive:
    """Starts AMCL's node, and a robot of its namespace that is ready to drive."""

    def start(
        *,
        namespace: str = "",
        active: bool = True,
        parameters: dict[str, Any] | None = None,
        **of_drive: Any,
    ) -> "Drive":
        from tests.integration.ros.robot import Drive  # noqa: PLC0415 - only where ROS is

        moved = ("-r", f"__ns:={namespace}", *TF_IN_NAMESPACE) if namespace else ()
        given = {"autostart_node": active} | (parameters or {})
        node = start_node(*moved, parameters=given)
        drive = Drive(open_robot(namespace), node, **of_drive)
        drive.begin()
        return drive

    return start


@pytest.fixture(autouse=True, scope="session")
def on_this_machine_alone() -> Iterator[None]:
    """Discovery stays on the loopback interface."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield
