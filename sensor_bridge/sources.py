"""How often each source of observations is wrong, learned while the robot is localized."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from particle_filter.grid import Grid
from particle_filter.observations import Landmarks, Observation, outlier_probability
from protocol.answers import Belief
from protocol.errors import printable
from protocol.pose_arrays import covariance_matrix
from protocol.steps import Landmark

Source: TypeAlias = tuple[str, str]
"""A sender, and the landmark that it sees: one tag may have been moved. Empty: poses."""

PRIOR_SIGHTS = 2.0
"""Weight of the outlier probability that a source states [sights]."""
MOST_SIGHTS = 10.0
"""Weight of all past sights together, so that a mended source is found right again [sights]."""
BROKEN = 0.5
"""A source that is wrong more often than this does not count."""
MAX_SOURCES = 100
"""Further sources are not judged."""
_FIXES = Grid(np.zeros((1, 1), np.int8), 100.0, np.zeros(3))
"""Area over which wrong positions are spread."""


class Sources:
    """A Beta distribution of the outlier rate of each source.

    A sight is an outlier with the probability that its uniform part has at the robot's pose, while
    the belief is localized. It counts by the share of it that is new.
    """

    def __init__(self, landmarks: Sequence[Landmark]) -> None:
        self._landmarks = landmarks
        self._rates: dict[Source, tuple[float, float]] = {}
        """Numbers of wrong and right sights."""
        self._seen: deque[tuple[int, Source, Observation]] = deque(maxlen=256)

    def is_broken(self, source: Source) -> bool:
        wrong, right = self._rates.get(source, (0.0, 1.0))
        return wrong > BROKEN * (wrong + right)

    def saw(self, step: int, source: Source, seen: Observation) -> None:
        """Remember an observation until the belief after its step has come."""
        self._seen.append((step, source, seen))

    def judge(self, belief: Belief) -> None:
        """Judge the observations of a step by the belief after it."""
        seen = [(source, each) for step, source, each in self._seen if step == belief.step]
        later = [each for each in self._seen if each[0] > belief.step]
        self._seen = deque(later, self._seen.maxlen)
        if belief.state != "localized" or not belief.hypotheses:
            return
        for source, each in seen:
            if source in self._rates or len(self._rates) < MAX_SOURCES:
                self._learn(source, each, belief)

    def _learn(self, source: Source, seen: Observation, belief: Belief) -> None:
        best = belief.hypotheses[0]
        variances = np.maximum(np.diag(covariance_matrix(best.covariance)), 0.0)
        by_m, by_rad = math.sqrt(max(variances[:2])), math.sqrt(variances[2])
        whole = replace(seen.blurred(by_m, by_rad), share=1.0)
        named = (each for each in self._landmarks if each.name == seen.landmark)
        landmarks = Landmarks.of((each.name, each.x, each.y, each.sigma) for each in named)
        outlier = outlier_probability(np.array(best.pose), whole, landmarks, _FIXES)
        stated = seen.outlier_probability
        prior = PRIOR_SIGHTS * stated, PRIOR_SIGHTS * (1.0 - stated)
        wrong, right = self._rates.get(source, prior)
        wrong, right = wrong + seen.share * outlier, right + seen.share * (1.0 - outlier)
        kept = min(MOST_SIGHTS / (wrong + right), 1.0)
        self._rates[source] = kept * wrong, kept * right


def source_name(source: Source) -> str:
    """Return the sender and the landmark, short enough for a counter's name."""
    return printable(" ".join(filter(None, source)), 60)
