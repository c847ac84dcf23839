from pathlib import Path

from clustermcl.protocol import keys
from clustermcl.protocol.answers import CommandDone, Update
from clustermcl.protocol.message import PoseTuple
from tests.integration.conftest import OpenClient
from tests.integration.sensor_bridge.conftest import StartBridge
from tests.integration.sensor_bridge.robot import Robot
from tests.integration.waiting import answered
from tests.integration.worlds import write_room
from tests.unit.recordings.logs import laser_reading, odometry_reading


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
        self._robot.wait_until_taken()
        self._tick += 1


def test_an_update_requested_twice_makes_one_step(
    start_bridge: StartBridge, open_client: OpenClient, tmp_path: Path
) -> None:
    robot, session = start_bridge(write_room(tmp_path)), open_client()
    standing = Standing(robot)
    standing.scan()
    update = Update(sender="test", command_id="once")
    for _ in range(2):
        assert answered(session, keys.UPDATE, CommandDone, update).problem == ""
        standing.scan()
    assert len(robot.steps()) == 2
