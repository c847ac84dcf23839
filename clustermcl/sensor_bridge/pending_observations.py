"""Observations that wait for the next step, placed by odometry and weighed by their new share."""

import math
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from clustermcl.filter.arrays import Pose
from clustermcl.filter.motion.trajectory import MAX_LATE_NS, Trajectory
from clustermcl.filter.observations.field import Field
from clustermcl.filter.observations.observed import Observed
from clustermcl.filter.observations.sighting import Sighting
from clustermcl.filter.poses import between, compose
from clustermcl.jobs.wire_observations import from_wire, to_wire
from clustermcl.protocol.causes import AnyCause, Cause, Named
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.reading_checks import observation_problem
from clustermcl.protocol.steps import MAX_FIELDS, MAX_OBSERVATIONS, Landmark, Observation, Seen
from clustermcl.sensor_bridge.sources import Senders, Source, Sources, source_name
from clustermcl.sensor_bridge.stages import MAX_AHEAD_NS

MAX_WAITING = 64
"""Observations that wait for odometry; of more, those with the latest stamps are dropped."""
VIEW_M = 0.5
"""Distance driven after which 63 % of the error of an observation of the same landmark is new."""
SAME_FIELD_M = 5.0
"""Fields that a source reports within this distance have the same systematic error."""
SAME_M = 1.0
"""Observations of landmarks closer than this are of the same one, whatever their names."""
LEAST_SHARE = 0.02
"""An observation with a smaller new share is neither used nor remembered."""
FIRST_SHARE = 0.5
"""An observation with a larger new share makes a step, even if the robot stands."""
MAX_NAT = 30.0
"""Most that the observations of one step together add to the log-likelihood of a pose [nat]; in
worlds with tags, reflectors or fixes it is up to 24."""


@dataclass(frozen=True)
class _Past:
    """An observation that counted, by its new share."""

    kind: type[Observed]
    source: Source
    place: Pose
    """By odometry: the position of the landmark that was seen, else the robot's pose."""
    odom_from_robot: Pose
    stamp_ns: int
    share: float = 0.0


class PendingObservations:
    """The observations since the last step.

    A source errs in the same way for some time and some distance. So an
    observation counts only by its new share since the last one of the same thing: of a landmark by
    any sender, and of the robot's pose by this one; poses of several senders share one weight.

    `dropped` counts those not used, by cause, such as a field of a map with another digest.
    """

    def __init__(
        self, landmarks: Sequence[Landmark], dropped: Counter[AnyCause], map_digest: str = ""
    ) -> None:
        self._landmarks, self._dropped = tuple(landmarks), dropped
        self._map_digest = map_digest
        self._names = frozenset(landmark.name for landmark in landmarks)
        self._trajectory = Trajectory(most=400)
        self._waiting: list[tuple[Observation, Observed]] = []
        self._placed: list[tuple[Source, Observed, Pose, float]] = []
        self.sources, self._senders = Sources(landmarks), Senders()
        self._past: deque[_Past] = deque(maxlen=256)

    def on_observation(self, observation: Observation) -> None:
        """Queue an observation until odometry of its time has arrived."""
        newest_ns = self._trajectory.newest_ns
        match from_wire(observation):
            case Sighting(landmark=name) if name not in self._names:
                self._dropped[Cause.UNKNOWN_LANDMARK] += 1
            case Field(map_digest=digest) if digest not in ("", self._map_digest):
                self._dropped[Cause.OTHER_FIELD] += 1
            case _ if newest_ns is not None and observation.stamp_ns > newest_ns + MAX_AHEAD_NS:
                self._dropped[Cause.AHEAD] += 1
            case _ if not self._senders.admits(observation.sender, newest_ns or 0):
                self._dropped[Cause.MANY_SOURCES] += 1
            case seen:
                self._waiting.append((observation, seen))
        if len(self._waiting) > MAX_WAITING:  # so that no clock ahead takes the places of others
            self._waiting.remove(max(self._waiting, key=lambda each: each[0].stamp_ns))
            self._dropped[Cause.TOO_MANY] += 1

    def moved(self, stamp_ns: int, odom_from_robot: PoseTuple) -> bool:
        """Process odometry; return whether something was seen that had not been seen before."""
        newest_ns = self._trajectory.newest_ns
        if newest_ns is not None and stamp_ns < newest_ns - MAX_LATE_NS:  # the clock was set back
            self._past.clear()
            self._placed.clear()
        if stamp_ns != newest_ns:
            self._trajectory.add(stamp_ns, odom_from_robot)
        ready = [each for each in self._waiting if each[0].stamp_ns <= stamp_ns]
        self._waiting = [each for each in self._waiting if each[0].stamp_ns > stamp_ns]
        return max((self._place(*each) for each in ready), default=0.0) > FIRST_SHARE

    def take(self, step: int, odom_from_robot: PoseTuple) -> tuple[Seen, ...]:
        """Return the observations for the next step, relative to the robot's pose there."""
        after, placed = np.array(odom_from_robot), self._placed
        self._placed, usable, nat = [], [], 0.0
        for source, there, before, weight in placed:
            here = self.sources.as_known(source, there).moved(between(before, after))
            seen = to_wire(here, here.share * weight)
            # A step with an impossible observation would be refused by every worker.
            if observation_problem(seen) is not None:
                self._dropped[Cause.TOO_FAR_BACK] += 1
                continue
            self.sources.on_observation(step, source, here)
            if self.sources.is_broken(source):
                self._dropped[Named(f"reading refused: broken source {source_name(source)}")] += 1
            else:
                usable.append(seen)
                nat += weight * self.sources.most_nat(here)
        if nat > MAX_NAT:
            usable = [msgspec.structs.replace(e, share=e.share * MAX_NAT / nat) for e in usable]
        return tuple(usable)

    def landmarks_of(self, seen: Sequence[Seen]) -> tuple[Landmark, ...]:
        """Return the map's landmarks if one of them was seen."""
        return self._landmarks if any(each.landmark in self._names for each in seen) else ()

    def _place(self, observation: Observation, seen: Observed) -> float:
        """Place an observation by odometry; return the share of it that is new."""
        pose = self._trajectory.pose_at(observation.stamp_ns)
        if pose is None:
            self._dropped[Cause.NO_ODOMETRY] += 1
            return 0.0
        stamp_ns, sender, odom_from_robot = observation.stamp_ns, observation.sender, np.array(pose)
        match seen:
            case Sighting(landmark=name):
                place = compose(odom_from_robot, np.append(seen.mean, 0.0))
            case _:
                place, name = odom_from_robot, ""
        now = _Past(type(seen), (sender, name), place, odom_from_robot, stamp_ns)
        share, weight = self._share(now, observation.correlation_s)
        if share < LEAST_SHARE:
            return 0.0
        fields = sum(isinstance(each, Field) for _, each, _, _ in self._placed)
        too_many_fields = isinstance(seen, Field) and fields >= MAX_FIELDS
        if len(self._placed) >= MAX_OBSERVATIONS or too_many_fields:
            self._dropped[Cause.TOO_MANY] += 1
            return 0.0
        self._past.append(replace(now, share=share))
        if now.kind is not Sighting and sender in self._senders.poses_ns:
            self._senders.poses_ns[sender] = stamp_ns
        self._placed.append((now.source, replace(seen, share=share), odom_from_robot, weight))
        return share * weight

    def _share(self, now: _Past, correlation_s: float) -> tuple[float, float]:
        """Return the new share of an observation, and the weight of that share in the belief."""
        weight, apart, repeats = 1.0, 0.0, list[_Past]()
        if now.kind is Sighting:
            past = [p for p in self._past if p.kind is Sighting and _apart(p, now) <= SAME_M]
            if not past:
                return 1.0, weight
            last_ns = past[-1].stamp_ns
            apart = math.dist(past[-1].odom_from_robot[:2], now.odom_from_robot[:2]) / VIEW_M
            # Every observation of a moved landmark is wrong, so later ones weigh less. One
            # with another name is no repetition: the names before may have been false.
            repeats = [p for p in past if p.source[1] == now.source[1]]
        else:
            sender = now.source[0]
            weight /= 1.0 + self._senders.poses_besides(sender, now.stamp_ns)
            if (sent_ns := self._senders.poses_ns.get(sender)) is None:
                return 1.0, weight
            last_ns = sent_ns
            if now.kind is Field:
                past = [p for p in self._past if p.source == now.source]
                repeats = [p for p in past if _apart(p, now) <= SAME_FIELD_M]
        waited_s = abs(now.stamp_ns - last_ns) * 1e-9
        share = -math.expm1(-apart - waited_s / correlation_s)
        return share, weight / (1.0 + math.fsum(each.share for each in repeats))


def _apart(one: _Past, other: _Past) -> float:
    return math.dist(one.place[:2], other.place[:2])
