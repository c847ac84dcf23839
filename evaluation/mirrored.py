"""Mirrors a recording, which becomes a test of a robot that is off the map.

The mirrored robot has the same sensor noise, driver and building statistics, but is nowhere on the
map, unless the map is its own mirror image.
"""

import msgspec

from protocol.arrays import ArrayBlob
from protocol.message import PoseTuple
from protocol.steps import LaserBeams, Scan


def mirrored(scan: Scan) -> Scan:
    """Return the step mirrored at the robot's x axis."""
    others = tuple(msgspec.structs.replace(other, **_beams(other)) for other in scan.others)
    odom_from_robot = _reflected(scan.odom_from_robot)
    return msgspec.structs.replace(
        scan, odom_from_robot=odom_from_robot, others=others, **_beams(scan)
    )


def _beams(laser: Scan | LaserBeams) -> dict[str, object]:
    """Return the ranges in reverse order, and the angle of the first."""
    last_rad = laser.angle_min_rad + laser.angle_step_rad * (laser.ranges.shape[0] - 1)
    return {
        "ranges": ArrayBlob.of(laser.ranges.array()[::-1], "float32"),
        "angle_min_rad": -last_rad,
        "robot_from_laser": _reflected(laser.robot_from_laser),
    }


def _reflected(pose: PoseTuple) -> PoseTuple:
    x, y, heading = pose
    return x, -y, -heading
