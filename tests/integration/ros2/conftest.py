"""The bridge as a process, a ROS robot, and a double of our own system."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import msgspec
import pytest
import zenoh

from clustermcl.link.session import open_session
from clustermcl.recordings.rigid import IDENTITY
from clustermcl.runtime.ros2_settings import Ros2Settings
from clustermcl.runtime.settings import CoordinatorSettings, RobotSettings, Settings, ZenohSettings
from clustermcl.runtime.settings_table import settings_as_toml
from clustermcl.runtime.stop import StopFlag
from clustermcl.runtime.supervisor import python_module
from tests.integration.conftest import StartProcess
from tests.integration.processes import RunningProcess
from tests.integration.ros2.robot import RosRobot
from tests.integration.ros2.system_double import SystemDouble
from tests.integration.waiting import PATIENCE_S

StartBridge = Callable[..., RunningProcess]
OpenRobot = Callable[..., RosRobot]
OpenSystem = Callable[..., SystemDouble]
OpenSession = Callable[[], zenoh.Session]
Active = tuple[RosRobot, SystemDouble]
ACTIVE = Ros2Settings(autostart=True)


@pytest.fixture
def open_robot_session(zenoh_settings: ZenohSettings) -> Iterator[Callable[[], zenoh.Session]]:
    """Opens sessions with rmw_zenoh's settings; they are closed when the test ends."""
    with ExitStack() as sessions:
        yield lambda: sessions.enter_context(
            open_session(zenoh_settings, None, StopFlag(), wait_s=PATIENCE_S, peer=True)
        )


@pytest.fixture
def open_robot(open_robot_session: Callable[[], zenoh.Session]) -> OpenRobot:
    """Makes robots, each with a session of its own; they live as long as the test."""
    made: list[RosRobot] = []  # whose tokens would end with their last reference

    def robot(
        settings: Ros2Settings | None = None, *, name: str = "robot", humble: bool = False
    ) -> RosRobot:
        session = open_robot_session()
        made.append(RosRobot(session, settings or Ros2Settings(), name, humble=humble))
        return made[-1]

    return robot


@pytest.fixture
def open_system(zenoh_settings: ZenohSettings) -> Iterator[Callable[..., SystemDouble]]:
    """Makes doubles of our own system, each for a robot's name."""
    with ExitStack() as sessions:

        def system(name: str = "robot") -> SystemDouble:
            robot = RobotSettings(name=name)
            session = open_session(zenoh_settings, robot, StopFlag(), wait_s=PATIENCE_S)
            return SystemDouble(sessions.enter_context(session))

        yield system


@pytest.fixture
def start_bridge(
    zenoh_settings: ZenohSettings, start_process: StartProcess, tmp_path: Path
) -> StartBridge:
    """Starts bridges, with settings of `ros2`; returns once they say what is expected."""
    count = 0

    def start(
        ros2: Ros2Settings | None = None,
        *,
        robot: str = "robot",
        expect: str = "is running in ROS domain",
    ) -> RunningProcess:
        nonlocal count
        count += 1
        kept = CoordinatorSettings(state_folder=str(tmp_path))
        settings = Settings(zenoh=zenoh_settings, robot=RobotSettings(name=robot), coordinator=kept)
        file = tmp_path / f"bridge-{count}.toml"
        ros2 = ros2 or Ros2Settings()
        file.write_text(settings_as_toml(msgspec.structs.replace(settings, ros2=ros2)))
        process = start_process(python_module("clustermcl.ros2", "--settings", str(file)))
        process.wait_for(expect)
        return process

    return start


@pytest.fixture
def active(
    router: ZenohSettings,
    open_robot: OpenRobot,
    open_system: OpenSystem,
    start_bridge: StartBridge,
) -> Active:
    """A robot with a laser and our system, and between them a bridge that is active."""
    del router
    robot, system = open_robot(), open_system()
    robot.put_mounts(("laser", IDENTITY))
    start_bridge(ACTIVE)
    return robot, system
