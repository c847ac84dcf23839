"""Weights of particles and clusters, kept as natural logarithms.

The product of 180 densities underflows; its logarithm does not. Minus infinity is a weight of
zero; plus infinity and NaN are no weights.
"""

import math

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import LogWeights
from particle_filter.sums import weighted_sum


def log_sum(log_weights: LogWeights) -> float:
    """Logarithm of the summed weights; minus infinity where all are zero or there are none.

    Raises:
        ValueError: a weight is NaN or infinite.
    """
    largest = _largest(log_weights)
    if largest == -np.inf:
        return -np.inf
    return largest + float(np.log(np.exp(log_weights - largest).sum()))


def normalised(log_weights: LogWeights) -> NDArray[np.float64]:
    """The weights themselves, summing to one.

    Args:
        log_weights: (N,) with any common offset: 1e-300 and 1e+300 are as good as 1.

    Returns:
        (N,) weights.

    Raises:
        ValueError: all weights are zero, there are none, or one is NaN or infinite: there is
            no distribution to return, and a uniform one would be an invention.
    """
    weights = scaled(log_weights)
    return np.asarray(weights / weights.sum())


def scaled(log_weights: LogWeights) -> NDArray[np.float64]:
    """The weights themselves, the largest of them one; arguments and errors as `normalised`."""
    largest = _largest(log_weights)
    if largest == -np.inf:
        raise ValueError("no weight is above zero")
    weights = log_weights - largest
    return np.exp(weights, out=weights)


def effective_sample_size(log_weights: LogWeights) -> float:
    """Number of equally weighted particles of the same worth, (sum w)^2 / sum w^2.

    Between 1 and N; 0 where all weights are zero or there are none.

    Raises:
        ValueError: a weight is NaN or infinite.

    References:
        Kong, Liu and Wong, "Sequential imputations and Bayesian missing data problems" (1994).
    """
    if _largest(log_weights) == -np.inf:
        return 0.0
    return effective_size(scaled(log_weights))


def effective_size(weights: NDArray[np.float64]) -> float:
    """As `effective_sample_size`, of weights with any positive sum."""
    return float(weights.sum()) ** 2 / weighted_sum(weights, weights)


def _largest(log_weights: LogWeights) -> float:
    largest = float(log_weights.max()) if len(log_weights) else -math.inf
    if math.isnan(largest) or largest == math.inf:
        raise ValueError(f"a log-weight is {largest}")
    return largest
