"""Lines of recordings, small enough to read, and readings as robots send them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.laser.sensor_model import Beams
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import LaserBeams, LaserReading, OdometryReading, Scan
from clustermcl.recordings.recording import Recording, open_recording
from clustermcl.runtime.settings import BridgeSettings

ORIGIN: PoseTuple = (0.0, 0.0, 0.0)


def words(*values: object) -> str:
    return " ".join(map(str, values))


def odom(stamp: object, pose: Sequence[object] = ORIGIN) -> str:
    return words("ODOM", *pose, 0, 0, 0, stamp, "host", stamp)


def flaser(
    stamp: object,
    odometry: Sequence[object] = ORIGIN,
    ranges: Sequence[object] = (1.0,) * 180,
    pose: Sequence[object] | None = None,
) -> str:
    first = odometry if pose is None else pose
    return words("FLASER", len(ranges), *ranges, *first, *odometry, stamp, "host", stamp)


def robot_laser(
    stamp: object, ranges: Sequence[object], laser: Sequence[object], robot: Sequence[object]
) -> str:
    config = (0, -1.0, 2.0, 0.5, 30.0, 0.01, 0)
    tail = (0, 0, 0.3, 0.2, 1e6, stamp, "host", stamp)
    return words("ROBOTLASER1", *config, len(ranges), *ranges, 0, *laser, *robot, *tail)


def recording_of(folder: Path, *lines: str, settings: BridgeSettings | None = None) -> Recording:
    path = folder / "recording.log"
    path.write_text("".join(f"{line}\n" for line in lines))
    return open_recording(path, settings or BridgeSettings())


def scans_of(recording: Recording) -> list[LaserReading]:
    return [reading for reading in recording.readings if isinstance(reading, LaserReading)]


def odometry_of(recording: Recording) -> list[OdometryReading]:
    return [reading for reading in recording.readings if isinstance(reading, OdometryReading)]


def seconds(stamp_s: float) -> int:
    return round(stamp_s * 1e9)


def odometry_reading(stamp_s: float, pose: PoseTuple = ORIGIN) -> OdometryReading:
    return OdometryReading(sender="robot", stamp_ns=seconds(stamp_s), odom_from_robot=pose)


def beam_ends(laser: Scan | LaserBeams) -> NDArray[np.float64]:
    """(B, 2) where the beams end, in the robot's frame."""
    ranges = laser.ranges.array().astype(np.float64)
    angles = laser.angle_min_rad + laser.angle_step_rad * np.arange(len(ranges))
    return Beams(ranges, angles, np.array(laser.robot_from_laser)).hits_in_robot


def laser_reading(
    stamp_s: float, pose: PoseTuple | None = None, ranges: Sequence[float] = (1.0, 2.0, 3.0)
) -> LaserReading:
    return LaserReading(
        sender="robot",
        stamp_ns=seconds(stamp_s),
        ranges=ArrayBlob.of(np.array(ranges, np.float32), "float32"),
        angle_min_rad=-1.0,
        angle_step_rad=1.0,
        range_max_m=10.0,
        robot_from_laser=ORIGIN,
        odom_from_robot=pose,
    )
