"""Weights of particles, kept as natural logarithms.

The product of 180 densities underflows; its logarithm does not. Minus infinity is a weight of
zero; plus infinity and NaN are no weights. Sums are taken in the order of the particles, the same
in every process: numpy's would depend on how many threads it has.
"""

from math import inf, isfinite, log

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import LogWeights
from particle_filter.elementary_functions import exponentials
from particle_filter.kernels import kernel, plain


def normalised_weights(log_weights: LogWeights) -> NDArray[np.float64]:
    """The weights themselves, summing to one; arguments and errors as `weights_and_ess`."""
    return weights_and_ess(log_weights)[0]


def weights_and_ess(log_weights: LogWeights) -> tuple[NDArray[np.float64], float]:
    """The weights themselves, and how many even ones would tell as much.

    Args:
        log_weights: (N,) with any common offset: 1e-300 and 1e+300 are as good as 1.

    Returns:
        (N,) weights that sum to one, and the effective sample size (sum w)^2 / sum w^2, between
        1 and N.

    Raises:
        ValueError: all weights are zero, there are none, or one is NaN or infinite: there is
            no distribution to return, and a uniform one would be an invention.

    References:
        Kong, Liu and Wong, "Sequential imputations and Bayesian missing data problems" (1994).
    """
    weights, largest, effective = _weights_and_ess(plain(log_weights))
    _check(largest, effective)
    return weights, effective


def log_sum(log_weights: LogWeights) -> float:
    """Logarithm of the sum of (N,) weights; minus infinity of none, or where all are zero."""
    return float(_log_sum(plain(log_weights)))


def multiplied(
    log_weights: LogWeights, log_likelihood: LogWeights, exponent: float, penalty: LogWeights
) -> tuple[LogWeights, float]:
    """Weights times a likelihood to a power and a penalty, scaled to sum to N again.

    Args:
        log_weights: (N,) before.
        log_likelihood: (N,) of the scan.
        exponent: its power.
        penalty: (N,) logarithms, added as they are.

    Returns:
        (N,) log-weights, and the logarithm of the sum of the products before they were scaled.

    Raises:
        ValueError: as `weights_and_ess`.
    """
    after, total = _multiplied(plain(log_weights), plain(log_likelihood), exponent, plain(penalty))
    _check(total, total)
    return after, total


def _check(largest: float, total: float) -> None:
    if largest == -inf:
        raise ValueError("no weight is above zero")
    if not isfinite(total):
        raise ValueError("a log-weight is infinite or NaN")


@kernel
def _weights_and_ess(log_weights: LogWeights) -> tuple[NDArray[np.float64], float, float]:
    weights, largest = np.empty(len(log_weights)), _largest(log_weights)
    total = squares = 0.0
    exponentials(log_weights, largest, weights)
    for i in range(len(log_weights)):
        total += weights[i]
        squares += weights[i] * weights[i]
    for i in range(len(weights)):
        weights[i] /= total
    return weights, largest, total * total / squares


@kernel
def _log_sum(log_weights: LogWeights) -> float:
    largest, total = _largest(log_weights), 0.0
    if largest == -inf:
        return largest
    weights = np.empty(len(log_weights))
    exponentials(log_weights, largest, weights)
    for i in range(len(weights)):
        total += weights[i]
    return largest + log(total)


@kernel
def _multiplied(
    log_weights: LogWeights, log_likelihood: LogWeights, exponent: float, penalty: LogWeights
) -> tuple[LogWeights, float]:
    after = np.empty(len(log_weights))
    for i in range(len(after)):
        after[i] = log_weights[i] + exponent * log_likelihood[i] + penalty[i]
    log_total = _log_sum(after)
    for i in range(len(after)):
        after[i] -= log_total - log(len(after))
    return after, log_total


@kernel
def _largest(log_weights: LogWeights) -> float:
    largest = -inf
    for i in range(len(log_weights)):
        largest = max(largest, log_weights[i])
    return largest
