"""A robot with rubbish among its readings: the real bridge makes the steps of a quiet drive."""

import time
from pathlib import Path

from process_runtime.settings import BridgeSettings
from protocol import keys
from protocol.steps import Reading, Scan
from recordings.map_file import load_map
from sensor_bridge.step_maker import StepMaker
from tests.integration.sensor_bridge.conftest import StartBridge
from tests.integration.sensor_bridge.robot import Robot
from tests.integration.system.rubbish import bad_readings, no_messages
from tests.integration.waiting import wait_until
from tests.integration.worlds import write_room
from tests.unit.recordings.logs import laser_reading, odometry_reading

ROUNDS = 40

CAUSES = {
    "malformed LaserReading: not MessagePack", "malformed LaserReading: schema",
    "malformed OdometryReading: not MessagePack", "malformed OdometryReading: schema",
    "malformed OdometryReading: field", "reading refused: not finite",
    "reading refused: no returns", "reading refused: no beams",
    "reading refused: too many beams", "reading refused: bad geometry",
    "reading refused: malformed", "reading refused: outlier in time or place",
    "reading refused: stamp steps back",
}  # fmt: skip
"""All that `bad_readings` and `no_messages` give cause for."""


def quiet_drive() -> list[Reading]:
    """A metre a second, ten times a second; the last odometry releases the last scan."""
    drive: list[Reading] = []
    for tick in range(ROUNDS):
        drive.append(laser_reading(tick / 10))
        drive.append(odometry_reading(tick / 10 + 0.01, (tick / 10, 0.0, 0.0)))
    return drive


def spoil(robot: Robot, at_s: float) -> None:
    """In portions, for the bridge's inbox keeps sixteen scans at most."""
    reading_keys = (keys.LASER_READING, keys.ODOMETRY_READING)
    rubbish = [(key, data) for key, data in no_messages() if key in reading_keys]
    rubbish += bad_readings(laser_reading(at_s), odometry_reading(at_s, (at_s, 0.0, 0.0)))
    for number, (key, data) in enumerate(rubbish):
        robot.put(key, data)
        if number % 8 == 7:
            robot.steps()


def test_rubbish_among_readings_changes_no_step(start_bridge: StartBridge, tmp_path: Path) -> None:
    map_file, started_s = write_room(tmp_path), time.monotonic()
    robot = start_bridge(map_file)
    for number, reading in enumerate(quiet_drive()):
        robot.publish(reading)
        robot.steps()  # each key has a thread of its own: scans and odometry might change places
        if number % 10 == 5:
            spoil(robot, reading.stamp_ns / 1e9)
            robot.steps()
    wait_until(lambda: (robot.dropped() or {}).keys() >= CAUSES)
    dropped = robot.dropped() or {}
    assert robot.steps() == steps_of_a_quiet_drive(load_map(map_file).digest)
    assert dropped["reading refused: outlier in time or place"] >= 3
    assert "reading refused: odometry jumped" not in dropped
    assert robot.bridge is not None
    logged = [
        line for line in robot.bridge.err.splitlines() if "reading refused: no returns" in line
    ]
    assert 1 <= len(logged) <= 1 + (time.monotonic() - started_s) / 60.0, "once a minute"


def steps_of_a_quiet_drive(digest: str) -> list[Scan]:
    maker = StepMaker(BridgeSettings(), digest, "sensor_bridge", live=True)
    steps = [maker.on_reading(reading) for reading in quiet_drive()]
    return [step for step in steps if step is not None]
