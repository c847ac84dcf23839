"""Evidence of beam classes and a decoy for the robot being on the map (docs/unknown.md).

The best place on the map may still explain a scan badly. Two rates distinguish right places from
wrong ones: the share of beams near an obstacle that end on it, and the share of beams that pass
through a mapped obstacle. Both rates differ between maps. So there are two kinds of map and two
kinds of wrong place, and the filter learns their probabilities while the robot drives.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

_BEAMS = 16.0
"""Effective number of independent beams of a scan."""


class BeamClasses(NamedTuple):
    """Numbers of beams by class; beams without return are left out."""

    sharp: int
    """Number of beams that end on an obstacle that the laser can see from there."""
    blunt: int
    """Number that end near an obstacle, but not just before a close one."""
    through: int
    """Number that end behind an obstacle."""
    other: int
    """Number that end in front of an obstacle, as at a person, or beyond unmapped cells."""


class _Kind(NamedTuple):
    """Beta distributions of two rates, each as (yes, no)."""

    sharp: tuple[float, float]
    """Share of sharp beams among sharp and blunt ones."""
    through: tuple[float, float]
    """Share of through beams among sharp, blunt and through ones."""


_CLEAR, _CRUDE = _Kind((50.0, 0.8), (0.8, 30.0)), _Kind((30.0, 1.2), (4.0, 12.0))
"""Right places: in a map that shows what the laser sees, and in one that lacks doors and glass."""
_RESEMBLING, _FOREIGN = _Kind((9.0, 1.8), (2.0, 9.0)), _Kind((1.5, 1.0), (1.3, 1.5))
"""Wrong places: in a building that is much like this one, and in one that is not."""
_KINDS = (_CLEAR, _CRUDE, _RESEMBLING, _FOREIGN)
_CRUDE_SHARE, _RESEMBLING_SHARE = 0.1, 0.5
"""Probabilities of a crude map and of a resembling wrong place before the first view."""
_SHORT_SHARE, _SHORT_LEARNED = 0.2, 0.5
"""Share of short beams before the first view; weight of a new view in that share."""
_ODD_VIEW = 0.05
"""Share of the views of a right place that look like those of a wrong one."""
_LEAST_SHARE = 1e-12
"""Least share in a mixture, so that logarithms are finite."""
_FORGOTTEN = 0.002
"""Share of what was learned of the map that each view makes the filter forget."""

_DIFFERENCE = 1.0
"""Largest difference between the robot's fit and the decoy's that counts [nat/beam]."""
_DECOY_RIGHT, _DECOY_WRONG, _DECOY_ALIKE = (0.8, 0.45), (-0.25, 0.5), (0.0, 0.12)
"""Mean and standard deviation of that difference [nat/beam]: at right places, at wrong ones, and at
all places of a map that is its own mirror image."""
_ALIKE_SHARE = 0.5
"""Probability of a map that is its own mirror image before the first view."""


Share = Annotated[float, Meta(gt=0.0, lt=1.0)]


class MapQuality(msgspec.Struct, frozen=True):
    """Properties of the map, learned while localizing."""

    crude: Share = _CRUDE_SHARE
    """Probability that right places look as in a crude map."""
    resembling: Share = _RESEMBLING_SHARE
    """Probability that wrong places look as in a building much like this one."""
    short: Annotated[float, Meta(ge=0.0, le=1.0)] = _SHORT_SHARE
    """Share of the beams that are cut short."""
    alike: Share = _ALIKE_SHARE
    """Probability that the map is its own mirror image."""


def log_odds_by_decoy(
    quality: MapQuality, difference: float, log_here: float, new_view: float
) -> tuple[float, MapQuality]:
    """Return the evidence of a decoy for the robot being at a tracked place.

    The decoy fits as well as a robot that is not on the map. If the map is its own mirror image,
    robot and decoy fit equally well, and the evidence is zero.

    Args:
        quality: properties of the map, as estimated before this scan.
        difference: fit of the scan at the best place, minus fit of the mirrored scan at the decoy
            [nat/beam].
        log_here: log of the probability that the robot is at a tracked place.
        new_view: share of the scan that no earlier scan has shown, from 0 to 1.

    Returns:
        The change of the log-odds, and the quality after this scan.

    References:
        Elias and Gygi (2007), target-decoy search, Nature Methods 4.
    """
    d = min(max(difference, -_DIFFERENCE), _DIFFERENCE)
    right, wrong, alike = (
        -0.5 * ((d - mean) / sigma) ** 2 - math.log(sigma)
        for mean, sigma in (_DECOY_RIGHT, _DECOY_WRONG, _DECOY_ALIKE)
    )
    right = float(np.logaddexp(math.log1p(-_ODD_VIEW) + right, math.log(_ODD_VIEW) + wrong))
    right, wrong, alike = new_view * right, new_view * wrong, new_view * alike
    here, _ = _mixture(quality.alike, alike, right)
    not_here, _ = _mixture(quality.alike, alike, wrong)
    either, _ = _mixture(math.exp(log_here), right, wrong)
    _, alike_now = _mixture(quality.alike, alike, either)
    kept = alike_now + _FORGOTTEN * new_view * (_ALIKE_SHARE - alike_now)
    return here - not_here, msgspec.structs.replace(quality, alike=kept)


def log_odds_of_here(
    quality: MapQuality,
    probabilities: NDArray[np.float64],
    classes: Sequence[BeamClasses],
    new_view: float,
) -> tuple[float, MapQuality]:
    """Return the evidence of the beams' classes for the robot being at a tracked place.

    Args:
        quality: properties of the map, as estimated before this scan.
        probabilities: (K,) of the places, summing to one.
        classes: K of the scan's beams, each at the best pose of a place.
        new_view: how much of a new view of the building the scan is, from 0 to 1.

    Returns:
        The change of the log-odds, and the quality after this scan.
    """
    if new_view == 0.0:
        return 0.0, quality
    relative = _relative(quality, classes)
    with np.errstate(divide="ignore"):
        log_probabilities = np.log(probabilities)[:, None]
    log_kinds = new_view * np.logaddexp.reduce(log_probabilities + relative, axis=0)
    clear, crude, resembling, foreign = log_kinds.tolist()
    here, crude_now = _mixture(quality.crude, crude, clear)
    not_here, resembling_now = _mixture(quality.resembling, resembling, foreign)
    forgotten = _FORGOTTEN * new_view
    seen = new_view * _SHORT_LEARNED * probabilities
    short = np.array([each.other / sum(each) for each in classes])
    learned = MapQuality(
        crude_now + forgotten * (_CRUDE_SHARE - crude_now),
        resembling_now + forgotten * (_RESEMBLING_SHARE - resembling_now),
        quality.short + float(seen @ (short - quality.short)),
        quality.alike,
    )
    return here - not_here, learned


def probability_right(quality: MapQuality, classes: Sequence[BeamClasses]) -> NDArray[np.float64]:
    """Return (K,) probabilities that places are right, by beam classes alone and from even odds."""
    clear, crude = _relative(quality, classes)[:, :2].T
    log_odds = np.logaddexp(math.log1p(-quality.crude) + clear, math.log(quality.crude) + crude)
    return np.asarray(np.exp(-np.logaddexp(0.0, -log_odds)))


def _relative(quality: MapQuality, classes: Sequence[BeamClasses]) -> NDArray[np.float64]:
    """Return (K, 4) log-likelihoods of the counts by kind of place, relative to a wrong place."""
    logs = np.array([_log_likelihoods(each) for each in classes])
    log_wrong = np.logaddexp(
        math.log(quality.resembling) + logs[:, 2], math.log1p(-quality.resembling) + logs[:, 3]
    )
    relative = logs - log_wrong[:, None]
    relative[:, :2] = np.logaddexp(math.log1p(-_ODD_VIEW) + relative[:, :2], math.log(_ODD_VIEW))
    return relative


def _mixture(share: float, log_one: float, log_other: float) -> tuple[float, float]:
    """Return the log-likelihood of a mixture of two kinds, and the posterior share of the first."""
    share = min(max(share, _LEAST_SHARE), 1.0 - _LEAST_SHARE)
    one, other = math.log(share) + log_one, math.log1p(-share) + log_other
    total = float(np.logaddexp(one, other))
    return total, math.exp(one - total)


@lru_cache(maxsize=1024)  # a step asks three times for each cluster
def _log_likelihoods(classes: BeamClasses) -> tuple[float, ...]:
    """Return the log-likelihood of the counts for each kind of place; `other` does not count."""
    worth = _BEAMS / max(sum(classes), _BEAMS)
    sharp, blunt, through = (worth * count for count in classes[:3])
    return tuple(
        _log_beta_binomial(sharp, blunt, kind.sharp)
        + _log_beta_binomial(through, sharp + blunt, kind.through)
        for kind in _KINDS
    )


def _log_beta_binomial(yes: float, no: float, prior: tuple[float, float]) -> float:
    a, b = prior
    return _log_beta(a + yes, b + no) - _log_beta(a, b)


def _log_beta(a: float, b: float) -> float:
    return math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)
