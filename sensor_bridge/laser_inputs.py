"""The lasers of one robot: what each has sent that waits, and what joins the next step."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import msgspec
import numpy as np

from particle_filter.poses import between, compose
from protocol.arrays import ArrayBlob
from protocol.message import PoseTuple
from protocol.pose_arrays import pose_tuple
from protocol.reading_checks import MAX_LASERS
from protocol.steps import LaserBeams, LaserReading

MAX_APART_NS = 500_000_000
"""Another laser's scan joins a step if it was taken at most so long from the step's own [ns]."""


@dataclass
class LaserInput:
    """What one laser has sent."""

    waiting: deque[tuple[LaserReading, PoseTuple | None]] = field(default_factory=deque)
    """Scans that wait for the odometry after them, with their odometry where they bring it."""
    unused: tuple[LaserReading, PoseTuple] | None = None
    """The newest since the last step, with its odometry."""


class LaserInputs:
    """All lasers that have sent, by name, in the order of their first scan.

    The first is the one whose clock, with that of odometry, is the robot's; see `StepMaker`.
    """

    def __init__(self) -> None:
        self._inputs: dict[str, LaserInput] = {}

    def __iter__(self) -> Iterator[LaserInput]:
        return iter(self._inputs.values())

    def is_full_for(self, name: str) -> bool:
        """Whether a laser is one too many."""
        return name not in self._inputs and len(self._inputs) >= MAX_LASERS

    def of(self, name: str) -> LaserInput:
        """The laser of that name."""
        return self._inputs.setdefault(name, LaserInput())

    def hold(self, reading: LaserReading, odom_from_robot: PoseTuple) -> None:
        """No step was made of a scan; it may join one that another laser's makes."""
        self.of(reading.laser).unused = (reading, odom_from_robot)

    def used_for(self, reading: LaserReading, odom_from_robot: PoseTuple) -> tuple[LaserBeams, ...]:
        """A step is made of a scan: what the other lasers add to it. No scan is used twice.

        Args:
            reading: of the step.
            odom_from_robot: at its time.
        """
        found = []
        for name, laser in self._inputs.items():
            unused, laser.unused = laser.unused, None
            if unused is None or name == reading.laser:
                continue
            other, other_pose = unused
            if abs(other.stamp_ns - reading.stamp_ns) <= MAX_APART_NS:
                moved = between(np.array(odom_from_robot), np.array(other_pose))
                mount = pose_tuple(compose(moved, np.array(other.robot_from_laser)))
                found.append(msgspec.structs.replace(beams_of(other), robot_from_laser=mount))
        return tuple(found)


def beams_of(reading: LaserReading) -> LaserBeams:
    """What a laser measured: counter-clockwise, in float32, and 0 for what is too near."""
    ranges, start, step = reading.ranges, reading.angle_min_rad, reading.angle_step_rad
    if reading.upside_down:
        start, step = -start, -step
    if step < 0.0 or reading.range_min_m > 0.0 or ranges.dtype != "float32":
        values = ranges.array().astype(np.float32)
        values[values < reading.range_min_m] = 0.0
        if step < 0.0:  # the last beam becomes the first
            start, step, values = start + step * (len(values) - 1), -step, values[::-1]
        ranges = ArrayBlob.of(values, "float32")
    return LaserBeams(
        robot_from_laser=reading.robot_from_laser,
        angle_min_rad=start,
        angle_step_rad=step,
        range_max_m=reading.range_max_m,
        ranges=ranges,
    )
