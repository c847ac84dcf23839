"""The stages that a reading passes before the motion gate: checks, clock, odometry, lasers.

A stage takes one item and yields those for the next stage, so the path of a reading is the
list of stages in `StepMaker`. No stage knows a clock or a network.
"""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from msgspec.structs import replace

from clustermcl.filter.motion.trajectory import Trajectory
from clustermcl.filter.poses import compose, inverse, wrap_angle
from clustermcl.protocol import reading_checks
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.job_events import MAX_DETAIL_CHARACTERS
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.pose_arrays import pose_tuple
from clustermcl.protocol.steps import LaserReading, OdometryReading, Reading
from clustermcl.sensor_bridge.refused import Refused

MAX_AHEAD_NS = 10_000_000_000
"""A stamp further ahead of the newest one [ns] is used only if later readings agree."""
MAX_STEP_BACK_NS = 1_000_000_000
"""Readings may be this late [ns]; stamps of real recordings step back by up to 0.9 s."""
CONFIRMED_BY = 3
"""Readings in a row that agree with one another are no outliers."""
RESTART_AFTER = 20
"""After this many late readings in a row, the robot's clock is taken to be set back. After this
many readings that contradict the reference laser, their laser becomes the reference."""
SILENT_NS = 2_000_000_000
"""A laser or odometry without a reading for longer than this was silent [ns]."""
MAX_WAITING_SCANS = 8
"""Scans of a laser that wait for later odometry; with one more, the first uses the newest."""
MAX_SPEED_M_PER_S, MAX_TURN_RATE_RAD_PER_S = 10.0, 10.0
"""No robot in a building moves faster."""
MAX_JUMP_M = 100.0
"""A longer distance between two readings is an odometry jump, whatever time has passed."""
_SLACK_M, _SLACK_RAD = 1.0, 1.0  # stamps have errors, invented ones the largest
_MAX_BACK_S = 10.0


@dataclass(frozen=True)
class ClockRestarted:
    """The robot's clock was set back before the next reading."""


Item: TypeAlias = Reading | ClockRestarted


@dataclass
class Laser:
    """The scans of one laser that are not yet part of a step."""

    waiting: deque[LaserReading] = field(default_factory=deque)
    """Scans that wait for the odometry after them."""
    unused: LaserReading | None = None
    """The newest since the last step, with its odometry."""


Lasers: TypeAlias = dict[str, Laser]
"""By name, in the order of their first scan."""


def moved(start: PoseTuple, end: PoseTuple) -> tuple[float, float]:
    """Return the distance [m] and the turn [rad] between two poses."""
    return math.dist(start[:2], end[:2]), abs(wrap_angle(end[2] - start[2]))


def is_jump(before_ns: int, start: PoseTuple, after_ns: int, end: PoseTuple) -> bool:
    """Return whether the motion between two poses is faster than any robot's."""
    elapsed_s = (after_ns - before_ns) / 1e9
    if elapsed_s < -_MAX_BACK_S:
        elapsed_s = 0.0  # the clock was set back; the time between is unknown
    moved_m, turned_rad = moved(start, end)
    return (
        moved_m > min(MAX_JUMP_M, _SLACK_M + MAX_SPEED_M_PER_S * abs(elapsed_s))
        or turned_rad > _SLACK_RAD + MAX_TURN_RATE_RAD_PER_S * abs(elapsed_s)
    )  # fmt: skip


def _jumps(before: Reading | None, reading: Reading) -> bool:
    if before is None or before.odom_from_robot is None or reading.odom_from_robot is None:
        return False
    start, end = before.odom_from_robot, reading.odom_from_robot
    return is_jump(before.stamp_ns, start, reading.stamp_ns, end)


def _apart(before: Reading, reading: Reading) -> float:
    """Return the distance and turn between two readings, [m] plus [rad]; infinite without poses."""
    start, end = before.odom_from_robot, reading.odom_from_robot
    return math.inf if start is None or end is None else sum(moved(start, end))


class Clock:
    """Drops late readings; if all are late, the robot's clock was set back."""

    def __init__(self, dropped: Refused) -> None:
        self._dropped = dropped
        self.newest_ns: int | None = None
        self._late_in_a_row, self._late_s = 0, 0.0
        self._last_ns: dict[tuple[Cause, str], int] = {}
        """Stamp of the newest reading of odometry, and of each laser [ns]."""

    def __call__(self, reading: Reading) -> Iterator[Item]:
        stamp_ns = reading.stamp_ns
        newest_ns = stamp_ns if self.newest_ns is None else self.newest_ns
        if stamp_ns >= newest_ns - MAX_STEP_BACK_NS:
            self.newest_ns, self._late_in_a_row = max(stamp_ns, newest_ns), 0
            self._check_gap(reading)
            yield reading
            return
        self._late_in_a_row += 1
        if self._late_in_a_row == 1:
            self._late_s = (newest_ns - stamp_ns) / 1e9
        if self._late_in_a_row < RESTART_AFTER:
            self._dropped[Cause.STEPS_BACK] += 1
            return
        self._dropped.add(Cause.CLOCK_RESTARTED, f"{self._late_s:.1f} s back")
        self.newest_ns, self._late_in_a_row = stamp_ns, 0
        self._last_ns.clear()
        yield ClockRestarted()
        yield reading

    def _check_gap(self, reading: Reading) -> None:
        cause, name = Cause.ODOMETRY_SILENT, ""
        if isinstance(reading, LaserReading):
            cause, name = Cause.LASER_SILENT, reading.laser
        last_ns = self._last_ns.get((cause, name), reading.stamp_ns)
        self._last_ns[cause, name] = max(last_ns, reading.stamp_ns)
        if (gap_ns := reading.stamp_ns - last_ns) > SILENT_NS:
            which = f"{name}, " if name else ""
            self._dropped.add(cause, f"{which}for {gap_ns / 1e9:.1f} s")


class OutlierFilter:
    """Drops unusable readings, and holds outliers back until the next readings confirm them.

    A single reading with a stamp of next year would make all later ones late; a single wild pose
    would cost the motion across it. Only the next readings show whether it was an outlier, or
    the clock was set or the odometry restarted.

    Only odometry and one laser, the first, can confirm that. A scan of another laser that does
    not fit is dropped. When the first laser falls silent, another replaces it.
    """

    def __init__(self, clock: Clock, lasers: Lasers, dropped: Refused) -> None:
        self._clock, self._lasers, self._dropped = clock, lasers, dropped
        self._held: list[Reading] = []
        """At most `CONFIRMED_BY` - 1."""
        self._last_pose: Reading | None = None
        self._first_laser: str | None = None
        self._outliers_in_a_row = 0

    def __call__(self, reading: Reading) -> list[Reading]:
        if isinstance(reading, OdometryReading):
            problem = reading_checks.pose_problem(reading.odom_from_robot)
            problem = problem or reading_checks.stamp_problem(reading.stamp_ns)
            self._outliers_in_a_row = self._outliers_in_a_row if problem else 0
        else:
            problem = reading_checks.laser_problem(reading) or self._problem_of_laser(reading)
        if problem is not None:
            self._dropped.add(
                problem, reading_checks.numbers_of(reading, problem)[:MAX_DETAIL_CHARACTERS]
            )
            return []
        if isinstance(reading, OdometryReading) or self._is_first(reading):
            return self._checked(reading)
        return [reading]

    def released(self) -> list[Reading]:
        """Return the held readings, because no later reading can contradict them."""
        released, self._held = self._held, []
        for reading in released:
            if reading.odom_from_robot is not None:
                self._last_pose = reading
        return released

    def _is_first(self, reading: LaserReading) -> bool:
        if self._first_laser is None:
            self._first_laser = reading.laser
        return reading.laser == self._first_laser

    def _problem_of_laser(self, reading: LaserReading) -> Cause | None:
        if reading.laser not in self._lasers and len(self._lasers) >= reading_checks.MAX_LASERS:
            return Cause.TOO_MANY_LASERS
        if self._is_first(reading):
            self._outliers_in_a_row = 0
            return None
        newest_ns = self._clock.newest_ns
        in_time = newest_ns is None or abs(reading.stamp_ns - newest_ns) <= MAX_STEP_BACK_NS
        if in_time and not _jumps(self._last_pose, reading):
            return None
        self._outliers_in_a_row += 1
        if self._outliers_in_a_row < RESTART_AFTER:
            return Cause.OUTLIER
        self._first_laser, self._outliers_in_a_row = reading.laser, 0
        return None

    def _checked(self, reading: Reading) -> list[Reading]:
        newest_ns = self._clock.newest_ns
        ahead = newest_ns is not None and reading.stamp_ns > newest_ns + MAX_AHEAD_NS
        has_pose = reading.odom_from_robot is not None
        if not (ahead or _jumps(self._last_pose, reading) or self._continues_held(reading)):
            # A reading without a pose does not contradict a held one that is far away.
            self._drop([one for one in self._held if has_pose or not _jumps(self._last_pose, one)])
            self._last_pose = reading if has_pose else self._last_pose
            return [reading]
        if self._held and not self._agrees(reading):
            self._drop(self._held)
        self._held.append(reading)
        return self.released() if len(self._held) >= CONFIRMED_BY else []

    def _drop(self, outliers: list[Reading]) -> None:
        if outliers:
            self._dropped[Cause.OUTLIER] += len(outliers)
            self._held = [held for held in self._held if held not in outliers]

    def _continues_held(self, reading: Reading) -> bool:
        """Return whether a reading is nearer to a held jump than to the last pose.

        While readings are held, time passes, and a robot could have driven any jump.
        """
        last = self._last_pose
        held = [one for one in self._held if _jumps(last, one)]
        if not held or last is None or not self._agrees(reading):
            return False
        return _apart(held[-1], reading) < _apart(last, reading)

    def _agrees(self, reading: Reading) -> bool:
        with_pose = [held for held in self._held if held.odom_from_robot is not None]
        in_order = reading.stamp_ns >= self._held[-1].stamp_ns - MAX_STEP_BACK_NS
        return in_order and not _jumps(with_pose[-1] if with_pose else None, reading)


class OdometryContinuity:
    """Transforms odometry poses into one frame without jumps.

    A base controller that restarts counts from zero again: its odometry jumps although the robot
    did not. Workers move their particles by the difference of two odometry poses, so a jump would
    displace all particles. The motion across a jump is unknown. It is assumed to be zero; the
    motion noise covers a small one.
    """

    def __init__(self, dropped: Refused | None = None) -> None:
        self._dropped = Refused() if dropped is None else dropped
        self._last: tuple[int, PoseTuple] | None = None
        self._ours_from_theirs: PoseTuple | None = None

    def __call__(self, reading: Reading) -> list[Reading]:
        pose = reading.odom_from_robot
        if pose is None:
            return [reading]
        self.jumped(reading.stamp_ns, pose)
        if self._ours_from_theirs is None:
            return [reading]
        return [replace(reading, odom_from_robot=self.continuous(pose))]

    def jumped(self, stamp_ns: int, odom_from_robot: PoseTuple) -> bool:
        """Process the next pose; return whether the odometry frame jumped since the last one.

        Poses are passed in the order of arrival. After a jump, `continuous` makes the new pose
        equal to the last one. A single outlier is two jumps, and the second undoes the first.
        """
        last, self._last = self._last, (stamp_ns, odom_from_robot)
        if last is None or not is_jump(*last, stamp_ns, odom_from_robot):
            return False
        moved_m, turned_rad = moved(last[1], odom_from_robot)
        detail = f"by {moved_m:.2f} m and {math.degrees(turned_rad):.0f} deg"
        self._dropped.add(Cause.ODOMETRY_JUMPED, detail)
        ours = np.array(self.continuous(last[1]))
        correction = compose(ours, inverse(np.array(odom_from_robot)))
        self._ours_from_theirs = pose_tuple(correction)
        return True

    def continuous(self, odom_from_robot: PoseTuple) -> PoseTuple:
        """Return the pose in the continuous frame; the same before the first jump."""
        if self._ours_from_theirs is None:
            return odom_from_robot
        return pose_tuple(compose(np.array(self._ours_from_theirs), np.array(odom_from_robot)))


class Synchroniser:
    """Yields scans with the odometry pose at their time.

    A scan without an odometry pose waits for the first odometry after it.
    """

    def __init__(self, lasers: Lasers, dropped: Refused) -> None:
        self._lasers, self._dropped = lasers, dropped
        self._buffer = Trajectory(most=200)
        self.odometry: tuple[int, PoseTuple] | None = None
        """Stamp and pose of the newest odometry."""

    def __call__(self, item: Item) -> Iterator[LaserReading]:
        match item:
            case ClockRestarted():
                yield from self.released(at_most_waiting=0)
                self._buffer.clear()
                self.odometry = None
                return
            case OdometryReading():
                self._buffer.add(item.stamp_ns, item.odom_from_robot)
            case LaserReading():
                self._lasers.setdefault(item.laser, Laser()).waiting.append(item)
        pose = item.odom_from_robot
        if pose is not None and (self.odometry is None or item.stamp_ns >= self.odometry[0]):
            self.odometry = (item.stamp_ns, pose)
        yield from self.released()

    def released(self, at_most_waiting: int = MAX_WAITING_SCANS) -> Iterator[LaserReading]:
        """Yield the scans whose pose is known, and the oldest of a laser with too many waiting."""
        for laser in self._lasers.values():
            while laser.waiting:
                reading = laser.waiting[0]
                pose = reading.odom_from_robot
                known = pose is not None or self._buffer.reaches(reading.stamp_ns)
                if not known and len(laser.waiting) <= at_most_waiting:
                    break
                laser.waiting.popleft()
                if pose is None:
                    pose = self._buffer.pose_at(reading.stamp_ns)
                    if pose is None:
                        self._dropped[Cause.NO_ODOMETRY] += 1
                        continue
                    reading = replace(reading, odom_from_robot=pose)
                yield reading
