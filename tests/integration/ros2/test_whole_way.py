import math
import sys
import tempfile
import time
from bisect import bisect_left
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import replace
from itertools import chain
from pathlib import Path
from statistics import median
from typing import Any

import msgspec
import numpy as np
import psutil
import pytest
import zenoh

from clustermcl.commands.stack import COORDINATOR
from clustermcl.filter.poses import compose, wrap_angle
from clustermcl.link.session import open_session
from clustermcl.link.wire import is_alive
from clustermcl.protocol import keys
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.codec import decode
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import LaserReading, OdometryReading, Scan
from clustermcl.recordings.rigid import flat
from clustermcl.ros2.topics import AMCL_POSE, HYPOTHESIS_DETECTION
from clustermcl.runtime.ros2_settings import Ros2Settings
from clustermcl.runtime.settings import BridgeSettings, CoordinatorSettings
from clustermcl.runtime.stop import StopFlag
from clustermcl.sensor_bridge.step_maker import StepMaker, steps_from
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.alone import assert_same, outcomes_of_scans
from tests.integration.faults.system import SMALL, System, system
from tests.integration.ros2.robot import RosRobot, planar
from tests.integration.running import running
from tests.integration.waiting import PATIENCE_S, stretched_s, wait_until
from tests.maps import write_map

WORLD = "cross_feature"
ROS2 = Ros2Settings(enabled=True, autostart=True)
_BELIEVED_WITHIN_S = 3.0
_AT_EASE_S = 0.01


@contextmanager
def robot_and_system() -> Iterator[tuple[System, RosRobot]]:
    """Our processes on the map's file, and a robot on the same router."""
    with ExitStack() as resources:
        folder = Path(resources.enter_context(tempfile.TemporaryDirectory(prefix="mcl-map-")))
        map_file = write_map(world(WORLD).map, folder, "map")
        bridge = BridgeSettings(map=str(map_file), source="zenoh")
        coordinator = CoordinatorSettings(
            state_folder=str(folder / "state"), step_deadline_s=20.0, search_deadline_s=20.0
        )
        settings = msgspec.structs.replace(SMALL, bridge=bridge, ros2=ROS2, coordinator=coordinator)
        tested = resources.enter_context(system(settings))
        session = resources.enter_context(
            open_session(tested.settings.zenoh, None, StopFlag(), wait_s=PATIENCE_S, peer=True)
        )
        robot = RosRobot(session, ROS2)
        robot.put_map(world(WORLD).map)
        wait_until(lambda: "coordinator ready" in tested.log(COORDINATOR))
        wait_until(lambda: "is running in ROS domain" in tested.log("ros2"))
        wait_until(lambda: is_alive(tested.session, keys.BRIDGE_ALIVE, 1.0))
        yield tested, robot


class Drive:
    """A simulated robot that waits for the belief after each step, and knows where it is.

    When it is at ease, it pauses before and after each reading, as robots do.
    """

    def __init__(self, robot: RosRobot, tested: System) -> None:
        self._robot, self._tested = robot, tested
        self.truth: dict[int, PoseTuple] = {}
        self.readings: list[OdometryReading | LaserReading] = []
        self.sent_at_s: dict[int, float] = {}
        self.at_ease_from = 10**9
        """The first of the readings that are said at ease."""
        simulation = Simulation(world(WORLD), seed=3)
        self._ticks = iter(simulation)
        self._first = next(self._ticks)
        robot.put_mounts(("laser", flat(self._first.laser.robot_from_laser)))

    def driving(self) -> AbstractContextManager[StopFlag]:
        return running(self._drive)

    def _drive(self, stop: StopFlag) -> None:
        zero_ns = time.time_ns()
        maker = StepMaker(BridgeSettings(), "", "test")
        for tick in chain([self._first], self._ticks):
            self.truth[zero_ns + tick.laser.stamp_ns] = tick.map_from_robot
            for reading in tick.readings:
                stamp_ns = zero_ns + reading.stamp_ns
                stamped = msgspec.structs.replace(reading, stamp_ns=stamp_ns)
                self.readings.append(stamped)
                at_ease = len(self.readings) > self.at_ease_from
                if at_ease:
                    stop.wait(_AT_EASE_S)
                self._publish(stamped)
                if (scan := maker.on_reading(stamped)) is not None:
                    self._wait_for_belief(scan.stamp_ns, stop)
                if at_ease:
                    stop.wait(_AT_EASE_S)  # subscribers have the interpreter to themselves
            if stop.is_set():
                return

    def _publish(self, reading: OdometryReading | LaserReading) -> None:
        self.sent_at_s[reading.stamp_ns] = time.monotonic()
        if isinstance(reading, OdometryReading):
            self._robot.put_odometry(reading.stamp_ns, reading.odom_from_robot)
        else:
            self._robot.put_scan(reading, stamp_ns=reading.stamp_ns)

    def _wait_for_belief(self, stamp_ns: int, stop: StopFlag) -> None:
        """Wait for a limited time: ROS may lose scans, and the robot drives on."""
        until_s = time.monotonic() + _BELIEVED_WITHIN_S
        while time.monotonic() < until_s and not stop.wait(0.002):
            if self._tested.beliefs and self._tested.beliefs[-1].stamp_ns >= stamp_ns:
                return


class Receipts:
    """What the bridge says to our system, and when; and when beliefs come."""

    def __init__(self, tested: System) -> None:
        self.readings: list[OdometryReading | LaserReading] = []
        self.laser_at_s: dict[int, float] = {}
        self.belief_at_s: dict[int, float] = {}
        session = tested.session
        session.declare_subscriber(keys.LASER_READING, self._on_laser)
        session.declare_subscriber(keys.ODOMETRY_READING, self._on_odometry)
        session.declare_subscriber(keys.BELIEF, self._on_belief)

    def _on_laser(self, sample: zenoh.Sample) -> None:
        reading = decode(sample.payload.to_bytes(), LaserReading)
        self.laser_at_s[reading.stamp_ns] = time.monotonic()
        self.readings.append(reading)

    def _on_odometry(self, sample: zenoh.Sample) -> None:
        self.readings.append(decode(sample.payload.to_bytes(), OdometryReading))

    def _on_belief(self, sample: zenoh.Sample) -> None:
        belief = decode(sample.payload.to_bytes(), Belief)
        self.belief_at_s[belief.stamp_ns] = time.monotonic()


@pytest.fixture(autouse=True)
def short_turns() -> Iterator[None]:
    """The simulation releases the interpreter after 0.2 ms, so times are the subscribers'."""
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(2e-4)
    yield
    sys.setswitchinterval(before_s)


def stamp_of(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


@pytest.mark.timeout(300)
def test_a_ros_robot_is_localized_by_the_steps_of_a_robot_on_zenoh() -> None:
    with robot_and_system() as (tested, robot):
        receipts, drive = Receipts(tested), Drive(robot, tested)
        poses, transforms = robot.listen(AMCL_POSE), robot.listen(robot.topics.tf)
        places = robot.listen(HYPOTHESIS_DETECTION)
        with drive.driving():
            wait_until(lambda: places and len(places[-1].results) == 4)
            assert not poses  # none of four is the place
            wait_until(lambda: poses and tested.beliefs[-1].state == "localized", 150.0)
            count, drive.at_ease_from = len(poses), len(drive.readings)
            wait_until(lambda: len(poses) >= count + 40, 120.0)
        from_ros = steps_of(drive.readings, receipts.readings)
        wait_until(lambda: tested.beliefs[-1].stamp_ns >= from_ros[-1].stamp_ns)
        bridge_mb = psutil.Process(tested.pid("ros2")).memory_info().rss / 1e6
    last_pose = poses[-1]
    off = np.subtract(planar(last_pose.pose.pose), drive.truth[stamp_of(last_pose)])
    assert math.hypot(*off[:2]) < 0.2
    assert abs(wrap_angle(float(off[2]))) < 0.1
    # map to odom is stamped a second later than its scan, and carries odometry to the place.
    sent = {stamp_of(one.transforms[0]): one.transforms[0] for one in transforms}
    scans = [one for one in receipts.readings if isinstance(one, LaserReading)]
    last = next(one for one in reversed(scans) if one.stamp_ns + 10**9 in sent)
    assert last.odom_from_robot is not None
    moved = planar(sent[last.stamp_ns + 10**9].transform)
    reported = compose(np.array(moved), np.array(last.odom_from_robot))
    assert math.dist(reported[:2], drive.truth[last.stamp_ns][:2]) < 0.3
    assert bridge_mb < 70.0
    poses_at_s = dict(zip(map(stamp_of, poses), robot.received_at_s[AMCL_POSE.name], strict=True))
    assert_early_enough(drive, receipts, poses_at_s)
    alone = outcomes_of_scans(from_ros, world(WORLD).map, SMALL)
    assert len(tested.beliefs) >= len(alone) > 100
    assert_same(tested.beliefs[: len(alone)], alone)


@pytest.mark.timeout(400)
def test_a_new_map_of_ros_under_way_ends_at_the_right_place_in_it() -> None:
    before = world(WORLD).map
    x, y, heading = before.map_from_grid
    after = replace(before, map_from_grid=(x + 10.0, y - 5.0, heading))
    with robot_and_system() as (tested, robot), tested.client as client:
        poses, drive = robot.listen(AMCL_POSE), Drive(robot, tested)

        def is_at(moved_m: tuple[float, float]) -> bool:
            if not poses or stamp_of(poses[-1]) not in drive.truth:
                return False
            truth = np.add(drive.truth[stamp_of(poses[-1])][:2], moved_m)
            return math.dist(planar(poses[-1].pose.pose)[:2], truth) < 0.2

        with drive.driving():
            wait_until(lambda: is_at((0.0, 0.0)), 150.0)
            robot.put_map(after)
            wait_until(lambda: client.status().map_digest == after.digest)
            wait_until(lambda: is_at((10.0, -5.0)), 150.0)
        assert client.status().counters["map changed"] == 1


def assert_early_enough(drive: Drive, receipts: Receipts, poses_at_s: dict[int, float]) -> None:
    """From ROS's scan to AMCL's pose it takes hardly longer than from a scan to the belief.

    More is the time through the bridge to the reading, from the transform that a scan waits for,
    and the time from the belief to the pose.
    """
    at_ease = drive.readings[drive.at_ease_from :]
    odometry_ns = sorted(one.stamp_ns for one in at_ease if isinstance(one, OdometryReading))
    more_s = []
    for stamp_ns, at_s in poses_at_s.items():
        after = bisect_left(odometry_ns, stamp_ns)
        if 0 < after < len(odometry_ns):
            sent_at_s = max(drive.sent_at_s[one] for one in (stamp_ns, odometry_ns[after]))
            to_reading_s = receipts.laser_at_s[stamp_ns] - sent_at_s
            more_s.append(to_reading_s + at_s - receipts.belief_at_s[stamp_ns])
    assert len(more_s) > 20
    assert median(more_s) < stretched_s(0.02)


def steps_of(
    published: list[OdometryReading | LaserReading], receipts: list[OdometryReading | LaserReading]
) -> list[Scan]:
    """The steps of the robot's measurements equal those that our system received.

    A busy machine may lose a scan or a transform on ROS's side: the scans that came are compared,
    and their odometry wherever its transforms arrived too.
    """
    receipts = sorted(receipts, key=lambda one: one.stamp_ns)  # as far as it goes: more may come
    lasers_received = {one.stamp_ns for one in receipts if isinstance(one, LaserReading)}
    odometry_received = {one.stamp_ns for one in receipts if isinstance(one, OdometryReading)}
    odometry_ns = sorted(one.stamp_ns for one in published if isinstance(one, OdometryReading))
    published = [
        one
        for one in published
        if isinstance(one, OdometryReading) or one.stamp_ns in lasers_received
    ]
    assert len(lasers_received) > 100
    digest = world(WORLD).map.digest
    ours_made, theirs_made = (
        list(steps_from(readings, StepMaker(BridgeSettings(), digest, "test")))
        for readings in (published, receipts)
    )
    for ours, theirs in zip(ours_made, theirs_made, strict=True):
        assert ours.stamp_ns == theirs.stamp_ns
        np.testing.assert_array_equal(ours.ranges.array(), theirs.ranges.array())
        at = bisect_left(odometry_ns, ours.stamp_ns)
        came = odometry_received.issuperset(odometry_ns[max(at - 1, 0) : at + 1])
        np.testing.assert_allclose(
            ours.odom_from_robot, theirs.odom_from_robot, atol=1e-9 if came else 0.1
        )
        np.testing.assert_allclose(ours.robot_from_laser, theirs.robot_from_laser, atol=1e-12)
        assert (ours.range_max_m, ours.angle_step_rad) == pytest.approx(
            (theirs.range_max_m, theirs.angle_step_rad), rel=1e-6
        )  # ROS has them as float32
    return theirs_made
