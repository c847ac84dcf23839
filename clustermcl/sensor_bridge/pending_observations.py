"""Observations that wait for the next step, placed by odometry and weighed by their new share."""

import math
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from clustermcl.filter.arrays import Pose
from clustermcl.filter.motion.trajectory import MAX_LATE_NS, Trajectory
from clustermcl.filter.observations.observation import Observation as Placed
from clustermcl.filter.observations.position_fields import PositionField as Cells
from clustermcl.filter.poses import between, compose
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.causes import AnyCause, Cause, Named
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.reading_checks import observation_problem
from clustermcl.protocol.steps import (
    MAX_FIELDS,
    MAX_OBSERVATIONS,
    Landmark,
    Observation,
    PositionField,
    Seen,
)
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
class _Sight:
    source: str
    name: str
    place: Pose | None
    """(3,) the landmark's position by odometry; None: an observation of the robot's pose."""
    odom_from_robot: Pose
    stamp_ns: int
    share: float = 0.0
    """Share of it that was new."""
    is_field: bool = False


class PendingObservations:
    """The observations since the last step.

    A source errs in the same way for some time and some distance. So an
    observation counts only by its new share since the last one of the same thing: of a landmark by
    any sender, and of the robot's pose by this one; poses of several senders share one weight.

    Args:
        landmarks: landmarks of the map.
        dropped: counts dropped observations by cause.
        map_digest: of the map; fields of another one are dropped.
    """

    def __init__(
        self, landmarks: Sequence[Landmark], dropped: Counter[AnyCause], map_digest: str = ""
    ) -> None:
        self._landmarks, self._dropped = tuple(landmarks), dropped
        self._map_digest = map_digest
        self._names = frozenset(landmark.name for landmark in landmarks)
        self._trajectory = Trajectory(most=400)
        self._waiting: list[Observation] = []
        self._placed: list[tuple[Source, Placed, Pose, float]] = []
        self.sources, self._senders = Sources(landmarks), Senders()
        self._past: deque[_Sight] = deque(maxlen=256)

    def on_observation(self, observation: Observation) -> None:
        """Queue an observation until odometry of its time has arrived."""
        newest_ns = self._trajectory.newest_ns
        if observation.landmark and observation.landmark not in self._names:
            self._dropped[Cause.UNKNOWN_LANDMARK] += 1
        elif observation.field and observation.field.map_digest not in ("", self._map_digest):
            self._dropped[Cause.OTHER_FIELD] += 1
        elif newest_ns is not None and observation.stamp_ns > newest_ns + MAX_AHEAD_NS:
            self._dropped[Cause.AHEAD] += 1
        elif not self._senders.admits(observation.sender, newest_ns or 0):
            self._dropped[Cause.MANY_SOURCES] += 1
        else:
            self._waiting.append(observation)
        if len(self._waiting) > MAX_WAITING:  # so that no clock ahead takes the places of others
            self._waiting.remove(max(self._waiting, key=lambda each: each.stamp_ns))
            self._dropped[Cause.TOO_MANY] += 1

    def moved(self, stamp_ns: int, odom_from_robot: PoseTuple) -> bool:
        """Process odometry; return whether something was seen that had not been seen before."""
        newest_ns = self._trajectory.newest_ns
        if newest_ns is not None and stamp_ns < newest_ns - MAX_LATE_NS:  # the clock was set back
            self._past.clear()
            self._placed.clear()
        if stamp_ns != newest_ns:
            self._trajectory.add(stamp_ns, odom_from_robot)
        ready = [each for each in self._waiting if each.stamp_ns <= stamp_ns]
        self._waiting = [each for each in self._waiting if each.stamp_ns > stamp_ns]
        return max(map(self._place, ready), default=0.0) > FIRST_SHARE

    def take(self, step: int, odom_from_robot: PoseTuple) -> tuple[Seen, ...]:
        """Return the observations for the next step, relative to the robot's pose there."""
        after, placed = np.array(odom_from_robot), self._placed
        self._placed, usable, nat = [], [], 0.0
        for source, there, before, weight in placed:
            here = self.sources.as_known(source, there).moved(between(before, after))
            seen = Seen(
                landmark=here.landmark,
                mean=tuple(here.mean.tolist()),
                covariance=tuple(here.covariance.ravel().tolist()),
                outlier_probability=here.outlier_probability,
                share=here.share * weight,
                field=_on_the_wire(here.field),
            )
            # A step with an impossible observation would be refused by every worker.
            if observation_problem(seen) is not None:
                self._dropped[Cause.TOO_FAR_BACK] += 1
                continue
            is_broken = self.sources.is_broken(source)
            self.sources.on_observation(step, source, here, 0.0 if is_broken else seen.share)
            if is_broken:
                self._dropped[Named(f"reading refused: broken source {source_name(source)}")] += 1
            else:
                usable.append(seen)
                nat += weight * self.sources.most_nat(here)
        if nat > MAX_NAT:
            usable = [msgspec.structs.replace(e, share=e.share * MAX_NAT / nat) for e in usable]
        return tuple(usable)

    def landmarks_of(self, seen: Sequence[Seen]) -> tuple[Landmark, ...]:
        """Return the map's landmarks if one of them was seen."""
        return self._landmarks if any(each.landmark for each in seen) else ()

    def _place(self, observation: Observation) -> float:
        """Place an observation by odometry; return the share of it that is new."""
        pose = self._trajectory.pose_at(observation.stamp_ns)
        if pose is None:
            self._dropped[Cause.NO_ODOMETRY] += 1
            return 0.0
        mean, odom_from_robot, place = np.array(observation.mean), np.array(pose), None
        if observation.landmark:
            place = compose(odom_from_robot, np.append(mean, 0.0))
        name = observation.landmark
        stamp_ns, is_field = observation.stamp_ns, observation.field is not None
        sight = _Sight(
            observation.sender, name, place, odom_from_robot, stamp_ns, is_field=is_field
        )
        share, weight = self._share(sight, observation.correlation_s)
        if share < LEAST_SHARE:
            return 0.0
        fields = sum(each.field is not None for _, each, _, _ in self._placed)
        if len(self._placed) >= MAX_OBSERVATIONS or (observation.field and fields >= MAX_FIELDS):
            self._dropped[Cause.TOO_MANY] += 1
            return 0.0
        self._past.append(replace(sight, share=share))
        if place is None:
            self._senders.on_pose(observation.sender, stamp_ns)
        covariance = np.reshape(observation.covariance, (len(mean), len(mean)))
        odds = observation.outlier_probability
        seen = Placed(mean, covariance, observation.landmark, odds, share)
        if (field := observation.field) is not None:
            seen = replace(seen, field=Cells(field.cell_m, field.log_likelihoods.array()))
        source = (observation.sender, observation.landmark)
        self._placed.append((source, seen, odom_from_robot, weight))
        return share * weight

    def _share(self, sight: _Sight, correlation_s: float) -> tuple[float, float]:
        """Return the new share of an observation, and the weight of that share in the belief."""
        before, weight, apart = [p for p in self._past if self._is_same(p, sight)], 1.0, 0.0
        if sight.place is None:
            last_ns = self._senders.last_pose_ns(sight.source)
            weight /= 1.0 + self._senders.poses_besides(sight.source, sight.stamp_ns)
        else:
            last_ns = before[-1].stamp_ns if before else None
        if last_ns is None:
            return 1.0, weight
        if sight.place is not None:
            here = sight.odom_from_robot[:2]
            apart = math.dist(before[-1].odom_from_robot[:2], here) / VIEW_M
        waited_s = abs(sight.stamp_ns - last_ns) * 1e-9
        share = -math.expm1(-apart - waited_s / correlation_s)
        # Every observation of a moved landmark is wrong, so later ones weigh less. One
        # with another name is no repetition: the names before may have been false.
        if sight.is_field:
            here = sight.odom_from_robot[:2]
            before = [p for p in before if math.dist(p.odom_from_robot[:2], here) <= SAME_FIELD_M]
        elif sight.place is None:
            return share, weight
        repeated = math.fsum(each.share for each in before if each.name == sight.name)
        return share, weight / (1.0 + repeated)

    @staticmethod
    def _is_same(past: _Sight, sight: _Sight) -> bool:
        if past.place is None or sight.place is None:
            return past.source == sight.source and past.place is sight.place
        return math.dist(past.place[:2], sight.place[:2]) <= SAME_M


def _on_the_wire(field: Cells | None) -> PositionField | None:
    if field is None:
        return None
    values = ArrayBlob.of(field.log_likelihoods, "float32")
    return PositionField(cell_m=field.cell_m, log_likelihoods=values)
