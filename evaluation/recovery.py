"""Augmented MCL: random particles while scans fit worse than before."""

import math
from dataclasses import dataclass

_LOWEST_LOG = -700.0
"""The logarithm of the smallest likelihood that differs from 0."""


@dataclass(frozen=True)
class RecoveryGains:
    """Gains per step of the two running averages of the likelihood."""

    slow: float
    fast: float


@dataclass
class Recovery:
    """Compares the fast with the slow running average of the likelihood.

    References:
        Probabilistic Robotics (2005), table 8.3, with its `w_slow` and `w_fast`.
    """

    gains: RecoveryGains
    _slow: float | None = None
    _fast: float = 0.0

    def on_likelihood(self, log_average_likelihood: float) -> None:
        """Take the logarithm of a scan's mean likelihood over the particles."""
        average = math.exp(max(log_average_likelihood, _LOWEST_LOG))
        if self._slow is None:
            self._slow = self._fast = average
            return
        self._slow += self.gains.slow * (average - self._slow)
        self._fast += self.gains.fast * (average - self._fast)

    @property
    def random_share(self) -> float:
        """Share of the particles to draw uniformly; 0 before the first scan."""
        return max(0.0, 1.0 - self._fast / self._slow) if self._slow else 0.0
