"""Systematic and optimal resampling of weighted particles, both in O(N).

References:
    Douc, Cappe and Moulines, "Comparison of resampling schemes for particle filtering" (2005).
"""

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import LogWeights
from clustermcl.filter.kernels.compiled import kernel
from clustermcl.filter.log_weights import normalised_weights
from clustermcl.filter.slices import Slices

Weights = NDArray[np.float64]
Indices = NDArray[np.int64]


def resample(log_weights: LogWeights, count: int, rng: np.random.Generator) -> Indices:
    """Draw particles so that each is expected `count` times its normalised weight.

    The (N,) weights need not be normalised; `rng` is the source of one number.

    Returns:
        (count,) increasing indices of particles; never one of weight zero.

    Raises:
        ValueError: no weight is above zero, one is NaN or infinite, or `count` is not positive.
    """
    if count < 1:
        raise ValueError(f"count must be positive, not {count}")
    return systematic(normalised_weights(log_weights), count, rng.random())


@kernel
def systematic(weights: Weights, count: int, offset: float) -> Indices:
    """Return the (count,) indices of particles at evenly spaced cumulative weights.

    The (N,) weights sum to one; each draw has an offset in [0, 1) in its interval of 1 / count.
    """
    last = len(weights) - 1
    while last > 0 and weights[last] == 0.0:
        last -= 1
    unit = 1.0 / count
    drawn = np.empty(count, np.int64)
    j, end = 0, weights[0]
    for i in range(count):
        position = (i + offset) * unit
        # Rounding may leave the last position past the line's end: stop at the last weight.
        while end <= position and j < last:
            j += 1
            end += weights[j]
        drawn[i] = j
    return drawn


def optimal_resampling(
    log_weights: LogWeights, count: int, rng: np.random.Generator
) -> Slices[tuple[Indices, LogWeights]]:
    """Keep `count` particles, in slices: all heavy ones, and a sample of the light ones.

    Heavy particles keep their weights; the sampled ones share the weight of all light ones. The
    expected weight of each particle stays, with the least variance of all schemes that repeat no
    particle.

    The sum of the (N,) weights stays. If N is not larger than `count`, all are kept.

    Returns:
        Increasing indices of the kept particles, and their log-weights.

    References:
        Fearnhead and Clifford, "On-line inference for hidden Markov models via particle filters"
        (2003).
    """
    if len(log_weights) <= count:
        return np.arange(len(log_weights)), log_weights
    weights = normalised_weights(log_weights)
    yield
    is_heavy = _heavy(weights, count)
    heavy, rest = np.flatnonzero(is_heavy), np.where(is_heavy, 0.0, weights)
    others, weight = count - len(heavy), rest.sum()
    yield
    drawn = systematic(rest / weight, others, rng.random())
    yield
    best = int(np.argmax(weights))
    log_even = float(log_weights[best]) + np.log(weight / others / weights[best])
    chosen = np.concatenate([heavy, drawn])
    after = np.concatenate([log_weights[heavy], np.full(others, log_even)])
    in_order = np.argsort(chosen, kind="stable")
    return chosen[in_order], after[in_order]


def _heavy(weights: Weights, count: int) -> NDArray[np.bool_]:
    """Return (N,) whether each particle is heavier than the equal weight of the sampled ones."""
    is_heavy, known, even = np.zeros(len(weights), bool), 0, 1.0 / count
    while True:  # each heavy particle lowers the equal weight of the others
        heavier = weights > even
        found, rest = int(np.count_nonzero(heavier)), weights[~heavier].sum()
        if found in (known, count) or rest == 0.0:
            return is_heavy
        is_heavy, known, even = heavier, found, rest / (count - found)
