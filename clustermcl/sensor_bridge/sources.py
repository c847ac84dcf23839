"""How often each source of observations is wrong, learned while the robot is localized."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from clustermcl.filter.grid import Grid
from clustermcl.filter.observations.kind import Landmarks
from clustermcl.filter.observations.observed import Observed
from clustermcl.filter.observations.sighting import Sighting
from clustermcl.protocol.answers import Belief, Hypothesis
from clustermcl.protocol.errors import printable
from clustermcl.protocol.health import MAX_SOURCES, SourceHealth
from clustermcl.protocol.pose_arrays import covariance_matrix
from clustermcl.protocol.steps import MAX_LANDMARKS, Landmark

Source: TypeAlias = tuple[str, str]
"""A sender, and the landmark that it sees: one tag may have been moved. Empty: poses."""

PRIOR_OBSERVATIONS = 2.0
"""Weight of the outlier probability that a source states [observations]."""
MAX_OBSERVATIONS = 10.0
"""Weight of all past observations together, so that a repaired source recovers [observations]."""
BROKEN = 0.5
"""A source that is wrong more often than this does not count."""
COMPARED = 5.0
"""Weight of prior and observations from which on a source is known [observations]."""
LEAST_OUTLIER_PROBABILITY = 0.05
"""Of a source that is not known yet, whatever it states."""
MAX_KNOWN = 4 * MAX_LANDMARKS
"""Sources whose outlier rate is kept: several senders may see all landmarks."""
MAX_SENDERS, NEW_SENDERS, NEW_SENDERS_PER_MINUTE = 64, 16, 4.0
"""Senders that are kept; new ones that may come at once, and in each further minute."""
FORGOTTEN_S = 600.0
"""A sender that has reported no pose for this time [s] has no part in those of others."""
_FIXES = Grid(np.zeros((1, 1), np.int8), 100.0, np.zeros(3))
"""Area over which wrong positions are spread."""


class Senders:
    """The senders of observations, and how many of them report poses or positions.

    Errors of different senders may have one cause, and one program may use many names. So
    poses and positions of all senders share the weight of one sender.
    """

    def __init__(self) -> None:
        self.poses_ns: dict[str, int | None] = {}
        """Stamp of the last pose by sender; the sender that was heard last is the last."""
        self._new, self._newest_ns = float(NEW_SENDERS), 0

    def admits(self, sender: str, now_ns: int) -> bool:
        """Return whether a sender is known, or there have been few new ones lately."""
        waited_s = max(now_ns - self._newest_ns, 0) * 1e-9
        self._newest_ns = now_ns
        self._new = min(self._new + NEW_SENDERS_PER_MINUTE * waited_s / 60.0, NEW_SENDERS)
        if sender not in self.poses_ns:
            if self._new < 1.0:
                return False
            self._new -= 1.0
            if len(self.poses_ns) >= MAX_SENDERS:
                del self.poses_ns[next(iter(self.poses_ns))]
        self.poses_ns[sender] = self.poses_ns.pop(sender, None)
        return True

    def poses_besides(self, sender: str, stamp_ns: int) -> int:
        """Return the number of other senders of poses at about this time."""
        return sum(
            other != sender and last_ns is not None and abs(stamp_ns - last_ns) < FORGOTTEN_S * 1e9
            for other, last_ns in self.poses_ns.items()
        )


class Sources:
    """A Beta distribution of the outlier rate of each source.

    While the belief is localized, an observation is an outlier with the probability of the uniform
    part of its density at the robot's pose. It counts by its new share.
    """

    def __init__(self, landmarks: Sequence[Landmark]) -> None:
        self._landmarks = Landmarks.of((e.name, e.x, e.y, e.sigma) for e in landmarks)
        self._rates: dict[Source, tuple[float, float]] = {}
        """Numbers of wrong and right observations; the source that was compared last is last."""
        self._seen: deque[tuple[int, Source, Observed]] = deque(maxlen=256)

    def is_broken(self, source: Source) -> bool:
        wrong, right = self._rates.get(source, (0.0, 1.0))
        return wrong > BROKEN * (wrong + right)

    def as_known(self, source: Source, seen: Observed) -> Observed:
        """Return an observation with the outlier probability that its source deserves."""
        least = LEAST_OUTLIER_PROBABILITY
        if seen.outlier_probability >= least or sum(self._rates.get(source, ())) >= COMPARED:
            return seen
        return replace(seen, outlier_probability=least)

    def most_nat(self, seen: Observed) -> float:
        """Return the largest log-likelihood ratio of an observation at any pose [nat]."""
        return seen.share * seen.largest_log_ratio(self._landmarks, _FIXES)

    def health(self) -> tuple[SourceHealth, ...]:
        """Return the estimated outlier rates of compared sources, the highest first."""
        found = (
            SourceHealth(name=source_name(source), outlier_rate=wrong / (wrong + right))
            for source, (wrong, right) in self._rates.items()
        )
        return tuple(sorted(found, key=lambda source: -source.outlier_rate)[:MAX_SOURCES])

    def on_observation(self, step: int, source: Source, seen: Observed) -> None:
        """Store an observation until the belief of its step arrives."""
        self._seen.append((step, source, seen))

    def on_belief(self, belief: Belief) -> None:
        """Learn from the observations of a step and the belief after it."""
        seen = [each[1:] for each in self._seen if each[0] == belief.step]
        later = [each for each in self._seen if each[0] > belief.step]
        self._seen = deque(later, self._seen.maxlen)
        if belief.state != "localized" or not belief.hypotheses:
            return
        for source, each in seen:
            self._learn(source, each, self._outlier_probability(each, belief.hypotheses[0]))

    def _outlier_probability(self, seen: Observed, best: Hypothesis) -> float:
        """Return the probability that an observation is false if the robot is at a place."""
        variances = np.maximum(np.diag(covariance_matrix(best.covariance)), 0.0)
        by_m, by_rad = math.sqrt(max(variances[:2])), math.sqrt(variances[2])
        marks, blurred = self._landmarks, seen.blurred(by_m, by_rad)
        if isinstance(seen, Sighting):
            marks = marks.only(seen.landmark)
        return blurred.outlier_probability_at(np.array(best.pose), marks, _FIXES)

    def _learn(self, source: Source, seen: Observed, outlier: float) -> None:
        stated = seen.outlier_probability
        prior = PRIOR_OBSERVATIONS * stated, PRIOR_OBSERVATIONS * (1.0 - stated)
        wrong, right = self._rates.pop(source, prior)
        wrong, right = wrong + seen.share * outlier, right + seen.share * (1.0 - outlier)
        kept = min(MAX_OBSERVATIONS / (wrong + right), 1.0)
        self._rates[source] = kept * wrong, kept * right
        if len(self._rates) > MAX_KNOWN:
            del self._rates[next(iter(self._rates))]


def source_name(source: Source) -> str:
    """Return the sender and the landmark, short enough for a counter's name."""
    return printable(" ".join(filter(None, source)), 60)
