"""Makes numbered steps from a robot's readings: checks, synchronises and gates them."""

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from typing import Any

import numpy as np
from msgspec.structs import asdict, replace

from clustermcl.filter.laser.scan_matching import motion_by_scans
from clustermcl.filter.laser.sensor_model import LaserScan
from clustermcl.filter.poses import between, compose
from clustermcl.filter.settings import section_with
from clustermcl.jobs.scan_arrays import scan_of_laser
from clustermcl.protocol import steps
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.floors import ONE_MAP, Floors
from clustermcl.protocol.live_settings import AS_STARTED, LiveSettings
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.pose_arrays import pose_tuple
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.floor_observations import in_atlas
from clustermcl.sensor_bridge.own_robot import OwnRobot
from clustermcl.sensor_bridge.pending_observations import PendingObservations
from clustermcl.sensor_bridge.refused import Refused
from clustermcl.sensor_bridge.sources import Sources
from clustermcl.sensor_bridge.stages import (
    Clock,
    Lasers,
    OdometryContinuity,
    OutlierFilter,
    Synchroniser,
    moved,
)

STANDS = 0.25
"""A robot that has moved by less than this share of the gate stands."""
MAX_APART_NS = 500_000_000
"""Another laser's scan joins a step if it was taken within this time of the step's own [ns]."""


class MotionGate:
    """Opens for the first scan, and then after enough driving or turning since the last step.

    Scans of a standing robot repeat each other; each would sharpen the belief as if it were new
    information.
    """

    def __init__(self, settings: BridgeSettings) -> None:
        self.settings = settings
        self._last: PoseTuple | None = None
        self._is_open = False
        self.is_held = False
        """Nothing passes; a robot that has moved meanwhile passes after the release."""
        self.held_back = 0
        """Scans that would have passed."""

    def open_next(self) -> None:
        self._is_open = True

    def begin_again(self) -> None:
        """Open for the next scan, as for the first."""
        self._last, self._is_open = None, False

    def has_hardly_moved(self, odom_from_robot: PoseTuple) -> bool:
        """Return whether a robot at this pose still stands where it was at the last step."""
        return self._last is not None and not self._has_moved(odom_from_robot, STANDS)

    def on_scan(self, odom_from_robot: PoseTuple) -> bool:
        """Return whether a scan becomes a step; if so, later motion is measured from its pose."""
        if not (self._is_open or self._has_moved(odom_from_robot)):
            return False
        if self.is_held:
            self.held_back += 1
            return False
        self._last, self._is_open = odom_from_robot, False
        return True

    def _has_moved(self, odom_from_robot: PoseTuple, share: float = 1.0) -> bool:
        if self._last is None:
            return True
        gate, (driven_m, turned_rad) = self.settings, moved(self._last, odom_from_robot)
        return driven_m >= share * gate.gate_distance_m or turned_rad >= share * gate.gate_turn_rad


class StepMaker:
    """Makes numbered steps from a robot's readings; each reading passes several stages.

    A scan without an odometry pose waits for the first odometry after it, so `on_reading` may
    answer an odometry reading with the step of an earlier scan. Of several lasers, the first scan
    that passes the gate makes a step, and the newest scans of the others join it.

    The arguments are the motion gate's settings and what is put into every step, from `first_step`
    on; only `landmarks` can be observed.

    Attributes:
        dropped: readings that were not used, by cause; jumps of odometry, restarts of the
            clock and gaps are counted here too. Scans that the gate held back are not.
        gate: decides which scans become steps.
    """

    def __init__(
        self,
        settings: BridgeSettings,
        map_digest: str,
        sender: str,
        first_step: int = 0,
        lockstep: bool = False,
        live: bool = False,
        landmarks: Sequence[steps.Landmark] = (),
        floors: Floors = ONE_MAP,
    ) -> None:
        self.dropped, self._floors = Refused(), floors
        self._map_digest, self._sender = map_digest, sender
        self._lockstep, self._live = lockstep, live
        self._next_step = first_step
        self._settings, self._live_settings = settings, AS_STARTED
        self._lasers: Lasers = {}
        self._ready = deque[steps.Scan]()
        clock = Clock(self.dropped)
        self._outliers = OutlierFilter(clock, self._lasers, self.dropped)
        self._synchroniser = Synchroniser(self._lasers, self.dropped)
        self._own_robot = OwnRobot(self.dropped)
        self.gate = MotionGate(settings)
        self._observed = PendingObservations(landmarks, self.dropped, map_digest)
        self._last: tuple[PoseTuple, LaserScan] | None = None
        """Odometry and scan of the last step."""
        self._use_stages = (
            OdometryContinuity(self.dropped),
            clock,
            self._synchroniser,
            self._own_robot,
            self._gated,
        )

    def on_reading(self, reading: steps.Reading) -> steps.Scan | None:
        least_m = self._settings.min_range_m
        if isinstance(reading, steps.LaserReading) and reading.range_min_m < least_m:
            reading = replace(reading, range_min_m=least_m)
        self._pass([reading], (self._outliers, *self._use_stages))
        if self.odometry is not None:
            self._move(*self.odometry)
        return self._ready.popleft() if self._ready else None

    def observe(self, observation: steps.Observation) -> None:
        """Add an observation of another sensor to the next step."""
        try:
            observation = in_atlas(observation, self._floors)
        except ValueError as error:
            self.dropped.add(Cause.UNKNOWN_FLOOR, str(error))
            return
        self._observed.on_observation(observation)

    def on_belief(self, belief: Belief) -> Sources:
        """Learn how often sources of observations are wrong; return these."""
        sources = self._observed.sources
        sources.on_belief(self._floors.drawn(belief))
        return sources

    def _move(self, stamp_ns: int, odom_from_robot: PoseTuple) -> None:
        if self._observed.moved(stamp_ns, odom_from_robot):
            self.gate.open_next()

    def finish(self) -> steps.Scan | None:
        """Make a step from each waiting scan after the last reading; call until it returns None."""
        self._pass(self._outliers.released(), self._use_stages)
        self._pass(self._synchroniser.released(at_most_waiting=0), self._use_stages[-2:])
        return self._ready.popleft() if self._ready else None

    def all_steps(self, readings: Iterable[steps.Reading]) -> Iterator[steps.Scan]:
        """Yield all steps of a finite series of readings."""
        yield from filter(None, map(self.on_reading, readings))
        yield from iter(self.finish, None)

    def _pass(self, items: Iterable[Any], stages: Sequence[Callable[[Any], Iterable[Any]]]) -> None:
        """Pass items through the stages; each item passes all stages before the next begins."""
        for stage in stages:
            items = chain.from_iterable(map(stage, items))
        self._ready.extend(items)

    @property
    def odometry(self) -> tuple[int, PoseTuple] | None:
        """Stamp and pose of the newest odometry, in the same frame as that of the steps."""
        return self._synchroniser.odometry

    @property
    def stands(self) -> bool:
        """Whether the robot still is where it was at the last step."""
        return self.odometry is not None and self.gate.has_hardly_moved(self.odometry[1])

    def configure(self, live: LiveSettings) -> None:
        """Use these settings from the next step on."""
        self._live_settings = live
        self.gate.settings = section_with(self._settings, live)

    def change_map(
        self, map_digest: str, landmarks: Sequence[steps.Landmark] = (), floors: Floors = ONE_MAP
    ) -> None:
        """Change the map of all further steps; the next scan becomes a step."""
        self._map_digest, self._floors = map_digest, floors
        self._observed = PendingObservations(landmarks, self.dropped, map_digest)
        self.gate.begin_again()

    def _gated(self, reading: steps.LaserReading) -> Iterator[steps.Scan]:
        """Yield the step of a scan that passes the gate; keep another for a later step."""
        pose = reading.odom_from_robot
        assert pose is not None  # of the synchroniser
        self._move(reading.stamp_ns, pose)
        if not self.gate.on_scan(pose):
            self._lasers[reading.laser].unused = reading
            return
        step, seen = self._next_step, self._observed.take(self._next_step, pose)
        found, self._own_robot.found = self._own_robot.found, False
        self._next_step += 1
        beams = beams_of(reading)
        yield steps.Scan(
            sender=self._sender,
            step=step,
            stamp_ns=reading.stamp_ns,
            odom_from_robot=pose,
            motion_by_scans=self._motion_by_scans(pose, beams),
            **asdict(beams),
            map_digest=self._map_digest,
            lockstep=self._lockstep,
            live=self._live,
            others=tuple(self._others(reading, pose)),
            settings=self._live_settings,
            observations=seen,
            landmarks=self._observed.landmarks_of(seen),
            own_robot_found=found and step > 0,
            remarks=self.dropped.remarks(reading.stamp_ns),
            floors=self._floors,
        )

    def _motion_by_scans(self, pose: PoseTuple, beams: steps.LaserBeams) -> PoseTuple | None:
        """Return how scans contradict odometry since the last step, and keep this step's."""
        scan, last = scan_of_laser(beams), self._last
        self._last = pose, scan
        if last is None:
            return None
        by_odometry = between(np.array(last[0]), np.array(pose))
        motion = motion_by_scans(last[1], scan, by_odometry)
        if motion is None:
            return None
        apart_m, apart_rad = moved(pose_tuple(by_odometry), pose_tuple(motion))
        detail = f"by {apart_m:.2f} m and {math.degrees(apart_rad):.0f} deg"
        self.dropped.add(Cause.ODOMETRY_CONTRADICTED, detail)
        return pose_tuple(motion)

    def _others(
        self, reading: steps.LaserReading, odom_from_robot: PoseTuple
    ) -> Iterator[steps.LaserBeams]:
        """Yield the scans that other lasers add to a step; no scan is used twice."""
        for name, laser in self._lasers.items():
            other, laser.unused = laser.unused, None
            if other is None or other.odom_from_robot is None or name == reading.laser:
                continue
            if abs(other.stamp_ns - reading.stamp_ns) <= MAX_APART_NS:
                motion = between(np.array(odom_from_robot), np.array(other.odom_from_robot))
                mount = pose_tuple(compose(motion, np.array(other.robot_from_laser)))
                yield replace(beams_of(other), robot_from_laser=mount)


def beams_of(reading: steps.LaserReading) -> steps.LaserBeams:
    """Return a scan's beams: counter-clockwise, in float32, and 0 for ranges that are too near."""
    ranges, start, step = reading.ranges, reading.angle_min_rad, reading.angle_step_rad
    if reading.upside_down:
        start, step = -start, -step
    if step < 0.0 or reading.range_min_m > 0.0 or ranges.dtype != "float32":
        values = ranges.array().astype(np.float32)
        values[values < reading.range_min_m] = 0.0
        if step < 0.0:  # the last beam becomes the first
            start, step, values = start + step * (len(values) - 1), -step, values[::-1]
        ranges = ArrayBlob.of(values, "float32")
    return steps.LaserBeams(
        robot_from_laser=reading.robot_from_laser,
        angle_min_rad=start,
        angle_step_rad=step,
        range_max_m=reading.range_max_m,
        ranges=ranges,
    )
