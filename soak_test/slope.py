"""How fast a figure of a process grows, and how well that is known."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_BLOCKS = 10
_MOST_POINTS = 300
"""Pairs grow with the square."""
_LEAST_POINTS = 2 * _BLOCKS

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Slope:
    """Growth in units an hour."""

    per_hour: float
    standard_error: float


def robust_slope(lives: Sequence[tuple[Values, Values]]) -> Slope | None:
    """The median of the slopes between any two samples of one life (Theil and Sen).

    Samples of one process hang together for minutes, so that a formula for independent errors
    would promise too much; the error is that of a jackknife over ten stretches of time.

    Args:
        lives: (times [s], values) of each process that did the same job, one after the other.

    Returns:
        None for too few samples to tell.

    References:
        Sen (1968), Estimates of the regression coefficient based on Kendall's tau;
        Kunsch (1989), The jackknife and the bootstrap for general stationary observations.
    """
    thinned = _thinned(lives)
    times = np.concatenate([t for t, _ in thinned]) if thinned else np.empty(0)
    if len(times) < _LEAST_POINTS:
        return None
    whole = _median_slope(thinned)
    edges = np.quantile(times, np.linspace(0.0, 1.0, _BLOCKS + 1)[1:-1])
    estimates = np.array(
        [
            _median_slope([_without(life, edges, block) for life in thinned])
            for block in range(_BLOCKS)
        ]
    )
    if not np.isfinite([whole, *estimates]).all():
        return None
    spread = np.sum((estimates - estimates.mean()) ** 2)
    error = float(np.sqrt(spread * (_BLOCKS - 1) / _BLOCKS))
    return Slope(whole * 3600.0, error * 3600.0)


def _thinned(lives: Sequence[tuple[Values, Values]]) -> list[tuple[Values, Values]]:
    """At most so many samples in all, evenly."""
    total = sum(len(times) for times, _ in lives)
    stride = max(1, -(-total // _MOST_POINTS))
    return [(times[::stride], values[::stride]) for times, values in lives]


def _without(life: tuple[Values, Values], edges: Values, block: int) -> tuple[Values, Values]:
    times, values = life
    kept = np.searchsorted(edges, times, side="right") != block
    return times[kept], values[kept]


def _median_slope(lives: Sequence[tuple[Values, Values]]) -> float:
    """NaN where no life has two samples."""
    slopes = []
    for times, values in lives:
        first, second = np.triu_indices(len(times), k=1)
        apart_s = times[second] - times[first]
        slopes.append((values[second] - values[first])[apart_s > 0.0] / apart_s[apart_s > 0.0])
    together = np.concatenate(slopes) if slopes else np.empty(0)
    return float(np.median(together)) if len(together) else float("nan")
