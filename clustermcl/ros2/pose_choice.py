"""The choice of the place to publish as the robot's pose, and map -> odom from that place.

* `best`: the most probable place. It changes from step to step while places are equally probable,
  so that the pose jumps by metres.
* `localized`: the place in state `localized`; none in other states.
* `held`: the last localized place, even if others become possible, until another one is localized
  or its cluster ends. Meanwhile its covariance includes the others.

The robot's odometry may jump when its base controller restarts; beliefs refer to odometry without
jumps. So each belief is combined with the odometry of its scan, corrected for later jumps.
"""

import math

import numpy as np
from msgspec.structs import replace

from clustermcl.filter.poses import compose, inverse, wrap_angle
from clustermcl.protocol.answers import Belief, Hypothesis
from clustermcl.protocol.message import Covariance, PoseTuple
from clustermcl.protocol.pose_arrays import covariance_matrix, covariance_tuple, pose_tuple
from clustermcl.runtime.settings import Publish
from clustermcl.sensor_bridge.stages import OdometryContinuity

_SAME_PLACE_M, _SAME_HEADING_RAD = 1.0, 0.5
"""A held cluster that ends was merged into another one, if that is nearer than this."""


class PoseChoice:
    """Chooses the place to publish after each belief."""

    def __init__(self, publish: Publish) -> None:
        self.publish = publish
        self.held: int | None = None
        """The cluster of the place published last."""
        self.floor = ""
        """The floor of that place; empty: of a single map, or none was published yet."""

    def choose(self, belief: Belief, expected: PoseTuple | None) -> Hypothesis | None:
        """Return the place to publish after a step; None: there is none.

        While the robot is not localized, its covariance is that of all places. `expected` is the
        pose published last, predicted by odometry.
        """
        hypothesis = self._chosen(belief, expected)
        self.held = hypothesis.cluster if hypothesis else None
        if hypothesis is None:
            return None
        self.floor = hypothesis.floor
        if belief.state == "localized":
            return hypothesis
        here = on_floor(belief, self.floor).hypotheses
        covariance = mixture_covariance(here, hypothesis.pose)
        return replace(hypothesis, covariance=covariance)

    def _chosen(self, belief: Belief, expected: PoseTuple | None) -> Hypothesis | None:
        if not belief.hypotheses:
            return None
        if self.publish == "best" or belief.state == "localized":
            return belief.hypotheses[0]
        return self._kept(belief, expected) if self.publish == "held" else None

    def _kept(self, belief: Belief, expected: PoseTuple | None) -> Hypothesis | None:
        """Return the held cluster, or the one it was merged into, or the most probable one."""
        if self.held is None:
            return None
        for hypothesis in belief.hypotheses:
            if hypothesis.cluster == self.held:
                return hypothesis
        here = on_floor(belief, self.floor).hypotheses
        near = [one for one in here if expected and _same(one.pose, expected)]
        return (near or belief.hypotheses)[0]


def on_floor(belief: Belief, floor: str) -> Belief:
    """Return a belief with the places on one floor: those on others have coordinates of theirs."""
    if not belief.floors:
        return belief
    here = tuple(place for place in belief.hypotheses if place.floor == floor)
    return replace(belief, hypotheses=here)


def mixture_covariance(hypotheses: tuple[Hypothesis, ...], about: PoseTuple) -> Covariance:
    """Return the second moment of the robot's pose about `about`, if it is at one of the places."""
    total, weight = np.zeros((3, 3)), math.fsum(one.probability for one in hypotheses)
    for one in hypotheses:
        off = np.subtract(one.pose, about)
        off[2] = wrap_angle(float(off[2]))
        share = one.probability / weight if weight > 0.0 else 1.0 / len(hypotheses)
        total += share * (covariance_matrix(one.covariance) + np.outer(off, off))
    return covariance_tuple(total)


def _same(one: PoseTuple, other: PoseTuple) -> bool:
    return (
        math.dist(one[:2], other[:2]) < _SAME_PLACE_M
        and abs(wrap_angle(one[2] - other[2])) < _SAME_HEADING_RAD
    )


KEPT_SCANS = 2_000
"""Beliefs arrive one step after their scans, or some seconds late after a pause."""


class MapFromOdom:
    """Follows the odometry and computes map -> odom from the newest belief."""

    def __init__(self) -> None:
        self._continuity = OdometryContinuity()
        self._scans: dict[int, PoseTuple] = {}
        self._map_from_ours: PoseTuple | None = None

    def on_odometry(self, stamp_ns: int, odom_from_robot: PoseTuple) -> bool:
        """Handle the robot's odometry; return whether it jumped."""
        return self._continuity.jumped(stamp_ns, odom_from_robot)

    def on_scan(self, stamp_ns: int, odom_from_robot: PoseTuple) -> None:
        """Keep the odometry of a scan until its belief arrives."""
        self._scans[stamp_ns] = self._continuity.continuous(odom_from_robot)
        if len(self._scans) > KEPT_SCANS:
            del self._scans[next(iter(self._scans))]

    def forget_scans(self) -> None:
        self._scans.clear()

    def expected(self, stamp_ns: int) -> PoseTuple | None:
        """Return the last pose, predicted by odometry to the time of a scan; None: unknown."""
        ours = self._scans.get(stamp_ns)
        if ours is None or self._map_from_ours is None:
            return None
        return pose_tuple(compose(np.array(self._map_from_ours), np.array(ours)))

    def on_place(self, stamp_ns: int, map_from_robot: PoseTuple) -> None:
        """Handle the robot's pose at a scan; ignore that of an unknown scan."""
        ours = self._scans.get(stamp_ns)
        if ours is not None:
            robot_from_ours = inverse(np.array(ours))
            self._map_from_ours = pose_tuple(compose(np.array(map_from_robot), robot_from_ours))

    def forget_place(self) -> None:
        self._map_from_ours = None

    def place(self, odom_from_robot: PoseTuple) -> PoseTuple | None:
        """Return the pose of the odom frame in the map by the newest odometry; None: unknown."""
        if self._map_from_ours is None:
            return None
        theirs = np.array(odom_from_robot)
        ours = np.array(self._continuity.continuous(odom_from_robot))
        map_from_robot = compose(np.array(self._map_from_ours), ours)
        return pose_tuple(compose(map_from_robot, inverse(theirs)))
