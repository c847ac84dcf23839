"""A robot that stands: the real bridge makes steps of its scans when it is asked to."""

from pathlib import Path

import msgspec
import pytest

from clustermcl.client import Client
from process_runtime.settings import Settings, ZenohSettings
from protocol import keys
from protocol.answers import CommandDone, Update
from protocol.message import PoseTuple
from tests.integration.conftest import OpenClient
from tests.integration.sensor_bridge.conftest import StartBridge
from tests.integration.sensor_bridge.robot import Robot
from tests.integration.waiting import PATIENCE_S
from tests.integration.worlds import write_room
from tests.unit.recordings.logs import laser_reading, odometry_reading
from zenoh_link.wire import ask


class Standing:
    """Sends a scan and the odometry after it, a tenth of a second apart."""

    def __init__(self, robot: Robot) -> None:
        self._robot, self._tick = robot, 0

    def scan(self, pose: PoseTuple = (1.0, 2.0, 0.5)) -> None:
        for reading in (
            odometry_reading(self._tick / 10, pose),
            laser_reading(self._tick / 10 + 0.01, pose),
        ):
            self._robot.publish(reading)
            self._robot.steps()  # it has been taken
        self._tick += 1


def test_an_update_makes_one_step_of_a_robot_that_stands(
    start_bridge: StartBridge, router: ZenohSettings, tmp_path: Path
) -> None:
    robot = start_bridge(write_room(tmp_path))
    standing = Standing(robot)
    for _ in range(3):
        standing.scan()
    assert [step.step for step in robot.steps()] == [0]
    with Client(Settings(zenoh=router)) as client:
        client.update()
    for _ in range(3):
        standing.scan()
    assert [step.step for step in robot.steps()] == [0, 1]


def test_an_update_requested_twice_makes_one_step(
    start_bridge: StartBridge, open_client: OpenClient, tmp_path: Path
) -> None:
    robot, session = start_bridge(write_room(tmp_path)), open_client()
    standing = Standing(robot)
    standing.scan()
    update = Update(sender="test", command_id="once")
    for _ in range(2):
        assert (
            ask(session, keys.UPDATE, CommandDone, timeout_s=PATIENCE_S, message=update).problem
            == ""
        )
        standing.scan()
    assert len(robot.steps()) == 2


def test_scans_of_two_lasers_make_one_step_over_the_wire(
    start_bridge: StartBridge, tmp_path: Path
) -> None:
    robot = start_bridge(write_room(tmp_path))
    for tick in range(12):  # a tenth of a metre each
        at_s, pose = tick / 10, (tick / 10, 0.0, 0.0)
        robot.publish(odometry_reading(at_s, pose))
        for name, mount in (("front", (0.3, 0.0, 0.0)), ("rear", (-0.3, 0.0, 3.0))):
            reading = laser_reading(at_s, pose, [1.0, 2.0, 0.1])
            robot.publish(
                msgspec.structs.replace(
                    reading,
                    laser=name,
                    robot_from_laser=mount,
                    upside_down=name == "rear",
                    range_min_m=0.2,
                )
            )
            robot.steps()  # it has been taken
    first, *others = robot.steps()
    assert (first.others, len(others) >= 4) == ((), True)
    for step in others:
        (rear,) = step.others
        # The front laser's makes the step; the rear one's was taken a tenth of a metre before.
        assert step.robot_from_laser == (0.3, 0.0, 0.0)
        assert rear.robot_from_laser == pytest.approx((-0.4, 0.0, 3.0))
        assert step.ranges.array().tolist() == [1.0, 2.0, 0.0]
        assert rear.ranges.array().tolist() == [0.0, 2.0, 1.0]
