"""Weights of particles as natural logarithms, because a product of 180 densities underflows.

Minus infinity is a weight of zero; plus infinity and NaN are invalid. All processes compute the
same bits, because sums are taken in the order of the particles; numpy may choose another order.
"""

from math import inf, isfinite, log

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import LogWeights
from clustermcl.filter.kernels.compiled import kernel, plain
from clustermcl.filter.kernels.elementary_functions import exponentials


def normalised_weights(log_weights: LogWeights) -> NDArray[np.float64]:
    """Return (N,) linear weights that sum to one; arguments and errors as `weights_and_ess`."""
    return weights_and_ess(log_weights)[0]


def weights_and_ess(log_weights: LogWeights) -> tuple[NDArray[np.float64], float]:
    """Return linear weights and the effective sample size.

    Returns:
        (N,) weights that sum to one, and the effective sample size (sum w)^2 / sum w^2, between
        1 and N.

    Raises:
        ValueError: all weights are zero, there are none, or one is NaN or infinite.

    References:
        Kong, Liu and Wong, "Sequential imputations and Bayesian missing data problems" (1994).
    """
    weights, largest, effective = _weights_and_ess(plain(log_weights))
    _check(largest, effective)
    return weights, effective


def log_sum(log_weights: LogWeights) -> float:
    """Return the logarithm of the sum of (N,) weights; minus infinity if it is zero."""
    return float(_log_sum(plain(log_weights)))


def multiplied(
    log_weights: LogWeights, log_likelihood: LogWeights, exponent: float, penalty: LogWeights
) -> tuple[LogWeights, float]:
    """Multiply weights by a tempered likelihood and a penalty, scaled to sum to N; all are (N,).

    Returns:
        (N,) log-weights, and the logarithm of the sum of the weights before scaling.

    Raises:
        ValueError: as for `weights_and_ess`.
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
