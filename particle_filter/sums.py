"""Sums that are the same to the last bit in every process.

``@`` asks BLAS, which adds in another order when it has more threads than a worker has; the
beliefs of one process would then differ from those of many in their last digits.
"""

import numpy as np
from numpy.typing import NDArray


def weighted_sum(values: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    """The sum of (N,) values, each times its weight."""
    return float(np.einsum("n,n->", values, weights))
