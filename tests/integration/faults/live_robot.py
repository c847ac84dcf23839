"""A system whose robot is not of the stack: it publishes readings as a real one's driver does."""

import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np
import yaml
import zenoh
from msgspec.structs import replace

from clustermcl.commands.stack import COORDINATOR
from clustermcl.filter.poses import wrap_angle
from clustermcl.link.wire import Publisher
from clustermcl.protocol import keys
from clustermcl.protocol.answers import PoseAnswer
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.pose_arrays import covariance_matrix
from clustermcl.protocol.steps import OdometryReading
from clustermcl.runtime.settings import BridgeSettings, Settings
from clustermcl.runtime.stop import StopFlag
from clustermcl.runtime.supervisor import python_module
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.alone import assert_same, outcomes_of_scans
from tests.integration.faults.system import SMALL, System, system
from tests.integration.processes import RunningProcess
from tests.integration.running import running
from tests.integration.waiting import wait_until
from tests.maps import write_map

BRIDGE = "sensor_bridge"
WORLD = "cross"


@contextmanager
def with_bridge(
    world_name: str, settings: Settings = SMALL, landmarks: Sequence[dict[str, object]] = ()
) -> Iterator[System]:
    """The system with a bridge that waits for a robot's readings."""
    with tempfile.TemporaryDirectory(prefix="mcl-map-") as folder:
        map_file = write_map(world(world_name).map, Path(folder), "map")
        if landmarks:
            text = yaml.safe_dump({"landmarks": [*landmarks]})
            map_file.with_name("landmarks.yaml").write_text(text)
        bridge = BridgeSettings(map=str(map_file), source="zenoh")
        with system(replace(settings, bridge=bridge)) as tested:
            wait_until(lambda: "coordinator ready" in tested.log(COORDINATOR))
            yield tested


class Robot:
    """A simulated robot whose laser can fail; it knows where it really is.

    It drives `pace` times as fast as in its own time.
    """

    def __init__(self, session: zenoh.Session, world_name: str, pace: int = 4) -> None:
        self.has_laser, self._pace = True, pace
        self._simulation = Simulation(world(world_name), seed=3)
        self._odometry = Publisher(session, keys.ODOMETRY_READING)
        self._laser = Publisher(session, keys.LASER_READING)
        self._truth: dict[int, PoseTuple] = {}

    def driving(self) -> AbstractContextManager[StopFlag]:
        return running(self._drive)

    def _drive(self, stop: StopFlag) -> None:
        zero_ns = time.time_ns()
        for tick in self._simulation:
            for reading in tick.readings:
                stamp_ns = zero_ns + reading.stamp_ns // self._pace
                if stop.wait((stamp_ns - time.time_ns()) / 1e9):
                    return
                self._truth[stamp_ns] = tick.map_from_robot
                stamped = replace(reading, stamp_ns=stamp_ns)
                if isinstance(stamped, OdometryReading):
                    self._odometry.put(stamped)
                elif self.has_laser:
                    self._laser.put(stamped)

    def error(self, answer: PoseAnswer) -> np.ndarray:
        assert answer.pose is not None
        nearest = min(list(self._truth), key=lambda stamp_ns: abs(stamp_ns - answer.stamp_ns))
        off = np.subtract(answer.pose, self._truth[nearest])
        off[2] = wrap_angle(float(off[2]))
        return off

    def surprise(self, answer: PoseAnswer) -> float:
        """Its error in the answer's own standard deviations, squared: chi-square of 3."""
        assert answer.covariance is not None
        off = self.error(answer)
        return float(off @ np.linalg.solve(covariance_matrix(answer.covariance), off))


@contextmanager
def with_live_robot(
    settings: Settings = SMALL, *, rate_hz: float = 20.0
) -> Iterator[tuple[System, RunningProcess]]:
    """Start the system and a separate robot that drives regardless of the system's state."""
    with with_bridge(WORLD, settings) as tested:
        words = ["--settings", str(tested.folder / "settings.toml"), "--world", WORLD]
        command = python_module("tests.soak.driver", *words, "--rate-hz", str(rate_hz))
        robot = RunningProcess(command, tested.folder, "robot")
        try:
            yield tested, robot
        finally:
            robot.kill()


def assert_same_as_alone(tested: System) -> None:
    """All beliefs equal those of one process on the bridge's scans."""
    beliefs = list(tested.beliefs)  # before the scans: the robot drives on
    scans = tested.history()
    assert scans[0].step == 0
    assert_same(beliefs, outcomes_of_scans(scans, world(WORLD).map, tested.settings))
