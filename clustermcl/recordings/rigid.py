"""Rigid transforms in three dimensions as plain numbers, faster than small arrays."""

import math
from typing import Any, NamedTuple

from clustermcl.protocol.message import PoseTuple

MAX_MOUNT_M = 10.0
"""Largest distance of a laser from the robot's centre [m]; beyond it, the data are wrong."""
MAX_TILT_RAD = 0.1
"""Largest tilt of a laser [rad]; at 10 m it changes a range by 5 cm."""
_NEARLY_PARALLEL = 1.0 - 1e-8


class Rigid(NamedTuple):
    """The pose of a frame in an outer frame: a translation [m] and a unit quaternion."""

    x: float
    y: float
    z: float
    qx: float
    qy: float
    qz: float
    qw: float

    def of(self, inner: "Rigid") -> "Rigid":
        """Chain two transforms: `a_from_b.of(b_from_c)` is `a_from_c`."""
        ax, ay, az, aw = self[3:]
        bx, by, bz, bw = inner[3:]
        x, y, z = self._turned(inner.x, inner.y, inner.z)
        return Rigid(
            self.x + x,
            self.y + y,
            self.z + z,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        )

    def inverse(self) -> "Rigid":
        back = Rigid(0.0, 0.0, 0.0, -self.qx, -self.qy, -self.qz, self.qw)
        x, y, z = back._turned(-self.x, -self.y, -self.z)
        return back._replace(x=x, y=y, z=z)

    def towards(self, end: "Rigid", share: float) -> "Rigid":
        """Interpolate to `end`, rotations by slerp; a share of 0 gives this transform, 1 `end`."""
        q0, q1 = self[3:], end[3:]
        cosine = sum(a * b for a, b in zip(q0, q1, strict=True))
        sign = math.copysign(1.0, cosine)
        if abs(cosine) > _NEARLY_PARALLEL:
            w0, w1 = 1.0 - share, share
        else:
            angle = math.acos(abs(cosine))
            w0, w1 = math.sin((1.0 - share) * angle), math.sin(share * angle)
        turn = [w0 * a + sign * w1 * b for a, b in zip(q0, q1, strict=True)]
        length = math.hypot(*turn)
        shift = (a + share * (b - a) for a, b in zip(self[:3], end[:3], strict=True))
        return Rigid(*shift, *(part / length for part in turn))

    def planar(self) -> PoseTuple:
        """Return the projection onto the plane: x [m], y [m], heading [rad]."""
        qx, qy, qz, qw = self[3:]
        heading = math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
        return self.x, self.y, heading

    def up(self) -> float:
        """Return the z component of the z axis in the outer frame: 1 upright, -1 upside down."""
        return 1.0 - 2.0 * (self.qx * self.qx + self.qy * self.qy)

    def _turned(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        qx, qy, qz, qw = self[3:]
        tx, ty, tz = 2.0 * (qy * z - qz * y), 2.0 * (qz * x - qx * z), 2.0 * (qx * y - qy * x)
        return (
            x + qw * tx + qy * tz - qz * ty,
            y + qw * ty + qz * tx - qx * tz,
            z + qw * tz + qx * ty - qy * tx,
        )


IDENTITY = Rigid(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def flat(pose: PoseTuple) -> Rigid:
    x, y, heading = pose
    return Rigid(x, y, 0.0, 0.0, 0.0, math.sin(heading / 2.0), math.cos(heading / 2.0))


def rigid_of(shift: Any, turn: Any) -> Rigid:
    """Convert a translation and a quaternion of a message.

    Raises:
        ValueError: a number is not finite, or the quaternion's length is far from 1.
    """
    numbers = (shift.x, shift.y, shift.z, turn.x, turn.y, turn.z, turn.w)
    length = math.hypot(*numbers[3:])
    if not (all(map(math.isfinite, numbers)) and 0.5 < length < 2.0):
        raise ValueError(f"translation {numbers[:3]}, quaternion {numbers[3:]}: not a transform")
    return Rigid(*numbers[:3], *(part / length for part in numbers[3:]))


def is_upside_down(frame: str, base_from_laser: Rigid) -> bool:
    """Return whether a laser is mounted upside down, so that its beams run clockwise.

    Raises:
        ValueError: the laser's plane is not horizontal, or the laser is not on the robot.
    """
    up, away_m = base_from_laser.up(), math.hypot(base_from_laser.x, base_from_laser.y)
    tilt_rad = math.acos(min(abs(up), 1.0))
    if tilt_rad > MAX_TILT_RAD:
        raise ValueError(f"the laser {frame!r} is tilted by {math.degrees(tilt_rad):.0f} degrees")
    if away_m > MAX_MOUNT_M:
        raise ValueError(f"the laser {frame!r} is {away_m:.0f} m away")
    return up < 0.0
