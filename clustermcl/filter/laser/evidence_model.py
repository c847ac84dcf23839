"""How much a scan counts: its exponent, and the usual fit (docs/belief.md).

Beams of a scan are not independent, and errors of the map stay the same for about a metre of
driving. Where no pose explains the scan, because of people or moved furniture, all fit badly.
"""

import math
import sys
from typing import Annotated

import msgspec
from msgspec import Meta

from clustermcl.filter.laser.likelihood_field import peak
from clustermcl.filter.settings import SensorSettings

VIEW_M, VIEW_RAD = 0.8, 1.6
"""Distance and turn after which the errors of the map in two views correlate by 1/e [m], [rad]."""
SHORT_M = 2.0
"""Short beams are uniformly distributed over this length [m]."""
THROUGH_WEIGHT = 0.1
"""Share of the score of beams through walls that a place of a search loses."""
_UNKNOWN_VARIANCE, _LEAST_VARIANCE = 9.0, 0.1
"""Variance of the fits at one place [nat^2]: before the first scan, and at least."""
_HALF = 0.5
"""Residual at which a scan counts half: how much worse the best pose fits than one with every beam
on an obstacle [nat/beam]."""
_CHANCE = 3.0
"""Standard deviations by which a fit may be low by chance."""
LARGE_FALL = 4.0
"""Sum of larger shortfalls, or of evidence against a given place, that begins a search [nat]."""
_LEARNED, _LEARNED_BELOW = 0.1, 0.2
"""Weight of a scan in the mean of fits; factor of that weight while fits are low."""


def scan_exponent(beams: int, settings: SensorSettings) -> float:
    """Return the exponent of a scan's log-likelihood, because its beams are not independent.

    A scan of `max_beams` beams counts as `scan_likelihood_exponent * max_beams` independent beams.
    A scan of fewer beams counts as much, because they are farther apart, but never as more beams
    than it has.
    """
    exponent = settings.scan_likelihood_exponent
    if not 0 < beams < settings.max_beams or exponent >= 1.0:
        return exponent
    return min(exponent * settings.max_beams / beams, 1.0)


def share_by_fit(log_likelihood_per_beam: float, settings: SensorSettings) -> float:
    """Return how much a scan counts for poses, 0 to 1, by how well the best of them fits.

    Where a building has changed, or the robot is elsewhere, no pose explains the scan, and the one
    that fits best is one along moved walls.
    """
    residual = max(_log_hit(settings) - log_likelihood_per_beam, 0.0)
    return 1.0 / (1.0 + residual / _HALF)


def through_beam_loss(settings: SensorSettings) -> float:
    """Return the log-likelihood ratio of a beam on an obstacle and an unexplained beam [nat]."""
    return _log_hit(settings) - _log_unexplained(settings)


def short_beam_gain(rate: float, settings: SensorSettings) -> float:
    """Return the log-likelihood ratio of a beam that ends at a person and an unexplained one [nat].

    `rate` is the share of short beams in earlier scans; unexplained ones are uniformly distributed.
    """
    return max(math.log(rate / SHORT_M) - _log_unexplained(settings), 0.0) if rate > 0.0 else 0.0


def _log_hit(settings: SensorSettings) -> float:
    return math.log(peak(settings) + settings.random_weight / settings.max_range_m)


def _log_unexplained(settings: SensorSettings) -> float:
    return math.log(settings.random_weight / settings.max_range_m)


Finite = Annotated[float, Meta(ge=-sys.float_info.max, le=sys.float_info.max)]


class UsualFit(msgspec.Struct, frozen=True):
    """How well scans have fitted where the robot is localized: a one-sided CUSUM test (Page 1954).

    A place that resembles the true one explains most of a scan, so evidence against it accumulates
    slowly. If the fit drops by much more than its usual variation, the robot has probably been
    kidnapped; this test detects it within one or two scans.
    """

    mean: Finite | None = None
    """Mean of the scans' log-likelihoods [nat]; None: before the first scan."""
    variance: Annotated[float, Meta(gt=0.0, le=sys.float_info.max)] = _UNKNOWN_VARIANCE
    """Variance of the scans' log-likelihoods [nat^2]."""
    shortfall: Annotated[float, Meta(ge=0.0, le=sys.float_info.max)] = 0.0
    """Sum over the last scans of how much worse they fitted than chance explains [nat]."""

    @property
    def has_fallen(self) -> bool:
        """Whether scans fit so badly that a search begins."""
        return self.shortfall > LARGE_FALL

    def after(self, log_likelihood: float, news: float) -> "UsualFit":
        """Return the statistics after one more scan; `news`, 0 to 1, is how independent it is."""
        if self.mean is None:
            return UsualFit(log_likelihood)
        below = self.mean - log_likelihood
        by_chance = _CHANCE * math.sqrt(self.variance)
        if self.has_fallen:
            shortfall = self.shortfall if below > by_chance else 0.0
        else:
            shortfall = max(self.shortfall + below - by_chance, 0.0)
        learned = _LEARNED * news * (_LEARNED_BELOW if shortfall > 0.0 else 1.0)
        mean = self.mean - learned * below
        variance = self.variance + learned * ((mean - log_likelihood) ** 2 - self.variance)
        return UsualFit(mean, max(variance, _LEAST_VARIANCE), shortfall)
