"""How often each source of observations is wrong, learned while the robot is localized."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from particle_filter.grid import Grid
from particle_filter.observations import Landmarks, Observation, outlier_probability
from protocol.answers import Belief, Hypothesis
from protocol.errors import printable
from protocol.health import MAX_SOURCES, SourceHealth
from protocol.pose_arrays import covariance_matrix
from protocol.steps import Landmark

Source: TypeAlias = tuple[str, str]
"""A sender, and the landmark that it sees: one tag may have been moved. Empty: poses."""

PRIOR_OBSERVATIONS = 2.0
"""Weight of the outlier probability that a source states [observations]."""
MAX_OBSERVATIONS = 10.0
"""Weight of all past observations together, so that a repaired source recovers [observations]."""
BROKEN = 0.5
"""A source that is wrong more often than this does not count."""
RECENT_STEPS = 20
"""Steps over which the contribution of a source is summed."""
_FIXES = Grid(np.zeros((1, 1), np.int8), 100.0, np.zeros(3))
"""Area over which wrong positions are spread."""


class Sources:
    """A Beta distribution of the outlier rate of each source.

    While the belief is localized, an observation is an outlier with the probability of the uniform
    part of its density at the robot's pose. It counts by its new share.
    """

    def __init__(self, landmarks: Sequence[Landmark]) -> None:
        self._landmarks = landmarks
        self._rates: dict[Source, tuple[float, float]] = {}
        """Numbers of wrong and right observations."""
        self._seen: deque[tuple[int, Source, Observation, float]] = deque(maxlen=256)
        self._gains: deque[tuple[int, Source, float]] = deque(maxlen=1024)
        """Step, source and log-likelihood ratio of what counted in the last steps."""

    def is_broken(self, source: Source) -> bool:
        wrong, right = self._rates.get(source, (0.0, 1.0))
        return wrong > BROKEN * (wrong + right)

    def health(self) -> tuple[SourceHealth, ...]:
        """Return the estimated outlier rate of each source whose observations were compared."""
        recent = dict.fromkeys(self._rates, 0.0)
        for _, source, nat in self._gains:
            recent[source] += nat
        return tuple(
            SourceHealth(
                name=source_name(source),
                recent_nat=recent[source],
                outlier_rate=wrong / (wrong + right),
                broken_probability=1.0 - beta_below_half(wrong, right),
            )
            for source, (wrong, right) in self._rates.items()
        )

    def on_observation(self, step: int, source: Source, seen: Observation, weight: float) -> None:
        """Store an observation and its weight until the belief of its step arrives."""
        self._seen.append((step, source, seen, weight))

    def on_belief(self, belief: Belief) -> None:
        """Learn from the observations of a step and the belief after it."""
        seen = [each[1:] for each in self._seen if each[0] == belief.step]
        later = [each for each in self._seen if each[0] > belief.step]
        self._seen = deque(later, self._seen.maxlen)
        while self._gains and self._gains[0][0] <= belief.step - RECENT_STEPS:
            self._gains.popleft()
        if belief.state != "localized" or not belief.hypotheses:
            return
        for source, each, weight in seen:
            if source in self._rates or len(self._rates) < MAX_SOURCES:
                outlier = self._outlier_probability(each, belief.hypotheses[0])
                self._learn(source, each, outlier)
                self._gains.append((belief.step, source, -weight * math.log(outlier)))

    def _outlier_probability(self, seen: Observation, best: Hypothesis) -> float:
        """Return the probability that an observation is false if the robot is at a place."""
        variances = np.maximum(np.diag(covariance_matrix(best.covariance)), 0.0)
        by_m, by_rad = math.sqrt(max(variances[:2])), math.sqrt(variances[2])
        whole = replace(seen.blurred(by_m, by_rad), share=1.0)
        named = (each for each in self._landmarks if each.name == seen.landmark)
        landmarks = Landmarks.of((each.name, each.x, each.y, each.sigma) for each in named)
        return outlier_probability(np.array(best.pose), whole, landmarks, _FIXES)

    def _learn(self, source: Source, seen: Observation, outlier: float) -> None:
        stated = seen.outlier_probability
        prior = PRIOR_OBSERVATIONS * stated, PRIOR_OBSERVATIONS * (1.0 - stated)
        wrong, right = self._rates.get(source, prior)
        wrong, right = wrong + seen.share * outlier, right + seen.share * (1.0 - outlier)
        kept = min(MAX_OBSERVATIONS / (wrong + right), 1.0)
        self._rates[source] = kept * wrong, kept * right


def beta_below_half(a: float, b: float) -> float:
    """Return the probability that a Beta(a, b) variable is below one half.

    `scipy.special.betainc` gives the same, but scipy would double the memory of the bridge.

    References:
        NIST Digital Library of Mathematical Functions, 8.17.8, in the form of a power series.
    """
    term = total = 1.0
    for n in range(200):  # each term is about half of the one before
        term *= 0.5 * (a + b + n) / (a + 1.0 + n)
        total += term
    scale = math.lgamma(a + b) - math.lgamma(a + 1.0) - math.lgamma(b) - (a + b) * math.log(2.0)
    return min(total * math.exp(scale), 1.0)


def source_name(source: Source) -> str:
    """Return the sender and the landmark, short enough for a counter's name."""
    return printable(" ".join(filter(None, source)), 60)
