"""Which of several places is published as the robot's pose.

* `best`: the most probable place. It changes from step to step while places are equally probable,
  so that the pose jumps by metres.
* `localized`: the place in state `localized`; none in other states.
* `held`: the last localized place, even if others become possible, until another one is localized
  or its cluster ends. Meanwhile its covariance includes the others.
"""

import math
from dataclasses import dataclass
from typing import assert_never

import numpy as np

from particle_filter.poses import wrap_angle
from process_runtime.ros2_settings import Publish
from protocol.answers import Belief, Hypothesis
from protocol.message import Covariance, PoseTuple
from protocol.pose_arrays import covariance_matrix, covariance_tuple

_SAME_PLACE_M, _SAME_HEADING_RAD = 1.0, 0.5
"""A held cluster that ends was merged into another one, if that is nearer than this."""


@dataclass(frozen=True)
class Chosen:
    """The place to publish.

    Args:
        cluster: its number.
        map_from_robot: its mean, at the belief's stamp.
        covariance: of the place; while the robot is not localized, of all places.
        probability: of the place.
    """

    cluster: int
    map_from_robot: PoseTuple
    covariance: Covariance
    probability: float


class PoseChoice:
    """Chooses the place to publish after each belief.

    Args:
        publish: the rule.
    """

    def __init__(self, publish: Publish) -> None:
        self.publish = publish
        self.held: int | None = None
        """The cluster of the place published last."""

    def choose(self, belief: Belief, expected: PoseTuple | None) -> Chosen | None:
        """The place to publish after a step; None: there is none.

        Args:
            belief: after the step.
            expected: the pose published last, predicted by odometry.
        """
        hypothesis = self._chosen(belief, expected)
        self.held = hypothesis.cluster if hypothesis else None
        if hypothesis is None:
            return None
        covariance = hypothesis.covariance
        if belief.state != "localized":
            covariance = mixture_covariance(belief.hypotheses, hypothesis.mean)
        return Chosen(hypothesis.cluster, hypothesis.mean, covariance, hypothesis.probability)

    def _chosen(self, belief: Belief, expected: PoseTuple | None) -> Hypothesis | None:
        if not belief.hypotheses:
            return None
        best = belief.hypotheses[0]
        match self.publish:
            case "best":
                return best
            case "localized":
                return best if belief.state == "localized" else None
            case "held":
                return best if belief.state == "localized" else self._kept(belief, expected)
            case choice:
                assert_never(choice)

    def _kept(self, belief: Belief, expected: PoseTuple | None) -> Hypothesis | None:
        """The held cluster, or the one it was merged into, or the most probable one."""
        if self.held is None:
            return None
        for hypothesis in belief.hypotheses:
            if hypothesis.cluster == self.held:
                return hypothesis
        near = [one for one in belief.hypotheses if expected and _same(one.mean, expected)]
        return (near or belief.hypotheses)[0]


def mixture_covariance(hypotheses: tuple[Hypothesis, ...], about: PoseTuple) -> Covariance:
    """Second moment of the robot's pose about `about`, over all places: 3 x 3, row by row."""
    total = np.zeros((3, 3))
    for one in hypotheses:
        off = np.subtract(one.mean, about)
        off[2] = wrap_angle(float(off[2]))
        total += one.probability * (covariance_matrix(one.covariance) + np.outer(off, off))
    return covariance_tuple(total)


def _same(one: PoseTuple, other: PoseTuple) -> bool:
    return (
        math.dist(one[:2], other[:2]) < _SAME_PLACE_M
        and abs(wrap_angle(one[2] - other[2])) < _SAME_HEADING_RAD
    )
