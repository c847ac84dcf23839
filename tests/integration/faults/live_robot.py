"""A system whose robot is not of the stack: it publishes readings as a real one's driver does."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec

from clustermcl.stack import COORDINATOR
from process_runtime.settings import BridgeSettings, Settings
from process_runtime.supervisor import python_module
from robot_simulator.worlds.catalogue import world
from soak_test.map_file import write_map
from tests.integration.faults.system import SMALL, System, system
from tests.integration.processes import RunningProcess
from tests.integration.waiting import wait_until

BRIDGE = "sensor_bridge"
WORLD = "cross"


@contextmanager
def with_live_robot(
    settings: Settings = SMALL, *, rate_hz: float = 20.0
) -> Iterator[tuple[System, RunningProcess]]:
    """The system, and the robot, which drives on whatever happens to the system."""
    with tempfile.TemporaryDirectory(prefix="mcl-map-") as folder:
        map_file = write_map(world(WORLD).map, Path(folder), "map")
        bridge = BridgeSettings(map=str(map_file), source="zenoh")
        with system(msgspec.structs.replace(settings, bridge=bridge)) as tested:
            words = ["--settings", str(tested.folder / "settings.toml"), "--world", WORLD]
            command = python_module("soak_test.robot", *words, "--rate-hz", str(rate_hz))
            wait_until(lambda: "coordinator ready" in tested.log(COORDINATOR), 60.0)
            robot = RunningProcess(command, Path(folder), "robot")
            try:
                yield tested, robot
            finally:
                robot.kill()
