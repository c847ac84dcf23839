"""What a scan's evidence is worth between places (docs/evidence.md).

The average likelihood of a cluster's particles errs, for the map is not the building. Such errors
stay the same for about a metre of way, so scans taken within it tell it again, as if it were news;
where no place explains the scan, because people stand around or furniture was moved, each
place is wrong by about as much as all of them are, by chance more or less. So differences between
places count by how much of a new view the scan is, and less the worse even the best one fits.
"""

import math

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import Pose
from particle_filter.settings import BeliefSettings, SensorSettings

CONTENDED = 0.99
"""The most probable hypotheses with this share of the belief are the contenders."""

SHORT_M = 2.0
"""People stand anywhere up to here, so far as a beam would have gone."""


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


def counted(
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


def share_that_counts(new_view: float, misfit: float, rules: BeliefSettings) -> float:
    """Share of a difference in log evidence that is not the map's error.

    Args:
        new_view: how much of a new view of the building the scan is, from 0 to 1.
        misfit: how much worse the best particle fits than one could [nat/beam].
        rules: the misfit at which half counts.
    """
    if math.isnan(misfit) or math.isinf(rules.evidence_misfit):
        return new_view
    return new_view / (1.0 + (misfit / rules.evidence_misfit) ** 2)


def misfit(log_likelihood_per_beam: float, settings: SensorSettings) -> float:
    """How much worse a particle fits than one could whose beams all end on obstacles [nat/beam]."""
    peak = settings.hit_weight / (math.sqrt(2.0 * math.pi) * settings.hit_sigma_m)
    best = math.log(peak + settings.random_weight / settings.max_range_m)
    return max(best - log_likelihood_per_beam, 0.0)


def short_beam_gain(rate: float, settings: SensorSettings) -> float:
    """How much likelier a short beam is where people stand than one that nothing explains [nat].

    Args:
        rate: share of the beams that people have cut short so far.
        settings: what nothing explains is uniform up to the largest range.
    """
    by_people, by_nothing = rate / SHORT_M, settings.random_weight / settings.max_range_m
    return math.log(max(by_people / by_nothing, 1.0))


def way(before_from_after: Pose) -> tuple[float, float]:
    """How far a robot has driven [m] and turned [rad] on a motion of (3,)."""
    x, y, turn = before_from_after.tolist()
    return math.hypot(x, y), abs(turn)
