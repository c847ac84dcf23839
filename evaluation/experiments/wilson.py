"""How well a share is known that was counted in a few runs."""

import math
from typing import NamedTuple

Z_95 = 1.959963984540054
"""A standard normal number lies within so much of its mean in 95 % of all cases."""


class Interval(NamedTuple):
    """Bounds of a share."""

    low: float
    high: float


def wilson_interval(successes: int, trials: int, z: float = Z_95) -> Interval:
    """Confidence interval of the chance of success.

    Unlike the plain normal interval it is honest for few trials and for shares near 0 and 1:
    20 successes of 20 give 84 to 100 %, not 100 to 100 %.

    Args:
        successes: of the trials.
        trials: independent ones; of none, nothing is known.
        z: width in standard deviations; the default is for 95 %.

    Raises:
        ValueError: more successes than trials, or a negative number.

    References:
        Wilson, Probable inference, the law of succession, and statistical inference (1927).
    """
    if not 0 <= successes <= trials:
        raise ValueError(f"{successes} successes in {trials} trials")
    if trials == 0:
        return Interval(0.0, 1.0)
    share, square = successes / trials, z * z
    middle = share + square / (2 * trials)
    half = z * math.sqrt(share * (1.0 - share) / trials + square / (4 * trials * trials))
    scale = 1.0 + square / trials
    low, high = (middle - half) / scale, (middle + half) / scale
    return Interval(0.0 if successes == 0 else low, 1.0 if successes == trials else high)
