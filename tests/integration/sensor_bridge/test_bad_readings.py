"""A robot with rubbish among its readings: the real bridge makes the steps of a quiet drive."""

import math
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np

from process_runtime.settings import BridgeSettings, ZenohSettings
from process_runtime.supervisor import python_module
from protocol import keys
from protocol.arrays import ArrayBlob
from protocol.codec import encode
from protocol.steps import Reading, Scan
from recordings.map_file import load_map
from sensor_bridge.step_maker import StepMaker
from tests.integration.conftest import OpenClient, StartProcess
from tests.integration.sensor_bridge.robot import Robot
from tests.integration.system.rubbish import NO_MESSAGES
from tests.integration.waiting import wait_until
from tests.integration.worlds import write_room
from tests.unit.recordings.logs import laser_reading, odometry_reading

NAN, INF = math.nan, math.inf
ROUNDS = 40
HOUR_NS = 3600 * 10**9

CAUSES = {
    "malformed LaserReading: not MessagePack", "malformed LaserReading: schema",
    "malformed OdometryReading: not MessagePack", "malformed OdometryReading: schema",
    "malformed OdometryReading: field", "reading refused: not finite",
    "reading refused: no returns", "reading refused: no beams",
    "reading refused: too many beams", "reading refused: bad geometry",
    "reading refused: malformed", "reading refused: outlier in time or place",
    "reading refused: stamp steps back",
}  # fmt: skip
"""All that the robot below gives cause for."""


def quiet_drive() -> list[Reading]:
    """A metre a second, ten times a second; the last odometry releases the last scan."""
    drive: list[Reading] = []
    for tick in range(ROUNDS):
        drive.append(laser_reading(tick / 10))
        drive.append(odometry_reading(tick / 10 + 0.01, (tick / 10, 0.0, 0.0)))
    return drive


def rubbish(at_s: float) -> Iterator[tuple[str, bytes]]:
    """Everything wrong that a robot may say at a time."""
    usual = laser_reading(at_s)
    for data in NO_MESSAGES.values():
        yield keys.LASER_READING, data
        yield keys.ODOMETRY_READING, data
    for change in (
        {"ranges": ranges([NAN] * 3)}, {"ranges": ranges([0.0, -1.0, INF])}, {"ranges": ranges([])},
        {"ranges": ranges([1.0] * 30_000)}, {"angle_step_rad": 5.0}, {"angle_min_rad": NAN},
        {"ranges": ArrayBlob(dtype="float32", shape=(3,), data=b"12")},
        {"ranges": ArrayBlob(dtype="int8", shape=(2**40, 2**40), data=b"")},
        {"stamp_ns": 2**63 - 1}, {"stamp_ns": usual.stamp_ns + HOUR_NS}, {"stamp_ns": -HOUR_NS},
        {"odom_from_robot": (100.0 + at_s, 0.0, 0.0)}, {"odom_from_robot": (NAN, 0.0, 0.0)},
    ):  # fmt: skip
        yield keys.LASER_READING, encode(msgspec.structs.replace(usual, **change))
    for pose in ((at_s + 100.0, 0.0, 0.0), (INF, 0.0, 0.0), (0.0, 1e9, 0.0)):
        yield keys.ODOMETRY_READING, encode(odometry_reading(at_s, pose))


def ranges(values: list[float]) -> ArrayBlob:
    return ArrayBlob.of(np.array(values), "float32")


def spoil(robot: Robot, at_s: float) -> None:
    """In portions, for the bridge's inbox keeps sixteen scans at most."""
    for number, (key, data) in enumerate(rubbish(at_s)):
        robot.put(key, data)
        if number % 8 == 7:
            robot.steps()


def test_rubbish_among_readings_changes_no_step(
    router: ZenohSettings, start_process: StartProcess, open_client: OpenClient, tmp_path: Path
) -> None:
    map_file, started_s = write_room(tmp_path), time.monotonic()
    bridge = start_process(
        python_module(
            "sensor_bridge", "--map", str(map_file), "--set", f"zenoh.router={router.router}"
        )
    )
    robot = Robot(open_client())
    wait_until(lambda: robot.dropped() is not None)
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
    logged = [line for line in bridge.err.splitlines() if "reading refused: no returns" in line]
    assert 1 <= len(logged) <= 1 + (time.monotonic() - started_s) / 60.0, "once a minute"


def steps_of_a_quiet_drive(digest: str) -> list[Scan]:
    maker = StepMaker(BridgeSettings(), digest, "sensor_bridge", live=True)
    steps = [maker.on_reading(reading) for reading in quiet_drive()]
    return [step for step in steps if step is not None]
