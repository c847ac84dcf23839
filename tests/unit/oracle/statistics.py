"""When an average over seeds differs from an exact value by more than chance."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import t as students_t

FALSE_ALARMS = 1e-4
"""Probability of a false failure for new seeds; seeds are fixed, so a test is deterministic."""


def assert_is_mean_of(exact: float, values: Sequence[float], grid_error: float) -> None:
    """Compare the mean of independent values with an exact one.

    Args:
        exact: what it should be.
        values: one for each seed.
        grid_error: how far off the exact value may be by its grid's cells.
    """
    mean, count = float(np.mean(values)), len(values)
    error = float(np.std(values, ddof=1)) / count**0.5
    bound = float(students_t.ppf(1.0 - 0.5 * FALSE_ALARMS, count - 1)) * error + grid_error
    assert abs(mean - exact) <= bound, f"mean {mean:.4f}, exact {exact:.4f}, bound {bound:.4f}"
