"""What a scan's evidence is worth between places (docs/evidence.md).

The average likelihood of a cluster's particles errs, for the map is not the building. Such errors
stay the same for about a metre of way, so scans taken within it tell it again, as if it were news;
where no place explains the scan, because people stand around or furniture was moved, each
place is wrong by about as much as all of them are, by chance more or less. So differences between
places count by how much of a new view the scan is, and less the worse even the best one fits.
"""

import math
import sys
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from particle_filter.arrays import Pose
from particle_filter.settings import BeliefSettings, SensorSettings

CONTENDED = 0.99
"""The most probable hypotheses with this share of the belief are the contenders."""

SHORT_M = 2.0
"""People stand anywhere up to here, so far as a beam would have gone."""
_UNKNOWN_VARIANCE, _LEAST_VARIANCE = 9.0, 0.1
"""Of the fits at one place [nat^2], before any was seen, and at least."""
_CHANCE, _LARGE_SHORTFALL = 3.0, 4.0
"""Standard deviations that a fit may be low by chance; what exceeds them, in sum [nat]."""
_LEARNED, _LEARNED_BELOW = 0.1, 0.2
"""What a scan says of the usual fit, against all earlier ones; share of it while fits are low."""


def contenders(log_belief: NDArray[np.float64]) -> NDArray[np.bool_]:
    """The most probable hypotheses that together hold `CONTENDED` of the belief.

    Equally probable ones are all contenders, or none of them is.

    Args:
        log_belief: (K,) natural logarithms of probabilities, at least one of them finite.

    Returns:
        (K,) never all false.
    """
    probability = np.exp(log_belief - np.max(log_belief))
    ordered = np.sort(probability)
    up_to = np.cumsum(ordered)
    no_more_probable = up_to[np.searchsorted(ordered, probability, side="right") - 1]
    return np.asarray(no_more_probable > (1.0 - CONTENDED) * up_to[-1])


def tempered(
    log_evidence: NDArray[np.float64],
    contends: NDArray[np.bool_],
    share: NDArray[np.float64] | float,
    noise: float,
) -> NDArray[np.float64]:
    """How much each hypothesis gains on the best-fitting contender, as it counts.

    Differences within the Monte Carlo error of averages over particles count next to nothing:
    d |d| / (|d| + noise) for a difference of d, so that places that look alike stay alike. Far
    from zero this is linear. So the reference must be a contender: against an improbable
    hypothesis that fits far better, the noise between two probable ones would count in full.

    Args:
        log_evidence: (K,) log of each one's average likelihood; NaN, a missing report, stays.
        contends: (K,) which may be the reference; one that has reported at least.
        share: of a difference that counts, for all or (K,) for each. One, and a noise of zero, are
            the paper's update.
        noise: Monte Carlo error of a difference [nat].

    Returns:
        (K,) logarithms: at most zero for contenders.
    """
    gained = log_evidence - np.nanmax(log_evidence[contends])
    if noise > 0.0:
        size = np.abs(gained)
        gained = gained * size / (size + noise)
    return np.asarray(share * gained)


def evidence_weight(new_view: float, residual: float, rules: BeliefSettings) -> float:
    """Share of a difference in log evidence that is not the map's error.

    Args:
        new_view: how much of a new view of the building the scan is, from 0 to 1.
        residual: how much worse the best particle fits than one could [nat/beam].
        rules: the residual at which half counts.
    """
    if math.isnan(residual) or math.isinf(rules.evidence_residual):
        return new_view
    return new_view / (1.0 + (residual / rules.evidence_residual) ** 2)


def residual(log_likelihood_per_beam: float, settings: SensorSettings) -> float:
    """How much worse a particle fits than one could whose beams all end on obstacles [nat/beam]."""
    return max(_log_hit(settings) - log_likelihood_per_beam, 0.0)


def through_beam_loss(settings: SensorSettings) -> float:
    """How much likelier a beam that ends on an obstacle is than one that nothing explains [nat]."""
    return _log_hit(settings) - _log_unexplained(settings)


def short_beam_gain(rate: float, settings: SensorSettings) -> float:
    """How much likelier a short beam is where people stand than one that nothing explains [nat].

    Args:
        rate: share of the beams that people have cut short so far.
        settings: what nothing explains is uniform up to the largest range.
    """
    return max(math.log(rate / SHORT_M) - _log_unexplained(settings), 0.0) if rate > 0.0 else 0.0


def _log_hit(settings: SensorSettings) -> float:
    peak = settings.hit_weight / (math.sqrt(2.0 * math.pi) * settings.hit_sigma_m)
    return math.log(peak + settings.random_weight / settings.max_range_m)


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
    """Of the scans' log-likelihoods [nat]; None: there was none."""
    variance: Annotated[float, Meta(gt=0.0, le=sys.float_info.max)] = _UNKNOWN_VARIANCE
    """Of the same [nat^2]."""
    shortfall: Annotated[float, Meta(ge=0.0, le=sys.float_info.max)] = 0.0
    """By how much the last scans together fitted worse than chance explains [nat]."""

    @property
    def has_fallen(self) -> bool:
        """Whether a search is worth its price."""
        return self.shortfall > _LARGE_SHORTFALL

    def after(self, log_likelihood: float, news: float) -> "UsualFit":
        """Take a scan.

        Args:
            log_likelihood: of the scan, where the robot is believed to be.
            news: how much of an independent scan it is, from 0 to 1.
        """
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


def way(before_from_after: Pose) -> tuple[float, float]:
    """How far a robot has driven [m] and turned [rad] on a motion of (3,)."""
    x, y, turn = before_from_after.tolist()
    return math.hypot(x, y), abs(turn)
