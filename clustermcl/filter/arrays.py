"""Array types of the filter."""

from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

Pose: TypeAlias = NDArray[np.float64]
"""(3,) x [m], y [m], heading [rad]."""
Poses: TypeAlias = NDArray[np.float64]
"""(N, 3) x [m], y [m], heading [rad]."""
Points: TypeAlias = NDArray[np.float64]
"""(B, 2) x [m], y [m]."""
LogWeights: TypeAlias = NDArray[np.float64]
"""(N,) natural logarithms of weights or likelihoods, not necessarily normalised."""
Cells: TypeAlias = NDArray[np.int8]
"""(rows, cols) cells: 0 free, 1 occupied, -1 unknown; row 0 has the lowest y."""
LogField: TypeAlias = NDArray[np.float32]
"""(rows, cols) log-likelihood of a beam that ends in a cell."""

FREE, OCCUPIED, UNKNOWN = 0, 1, -1

F = TypeVar("F", bound=Callable[..., Any])
