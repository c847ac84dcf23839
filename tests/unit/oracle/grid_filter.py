"""An exact Bayes filter on a fine grid of poses: as obvious as can be, and shares no product code.

Everything is a sum over cells: the likelihood field cell by cell, the motion as a convolution for
each heading, Bayes' rule as a product. Its error is the size of its cells; halving them moves no
compared logarithm by 0.02.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve
from scipy.stats import t as students_t

from clustermcl.filter.settings import MotionSettings, SensorSettings
from tests.unit.filter import naive

Array = NDArray[np.float64]


class ExactField:
    """The likelihood field of a map whose corner is the origin (table 6.3), by brute force."""

    def __init__(self, cells: NDArray[np.int8], cell_m: float, settings: SensorSettings) -> None:
        self._cell_m = cell_m
        # A rim of one cell stands for all that is outside the map.
        far = naive.log_likelihood_at(np.inf, settings)
        self._log = np.pad(naive.log_field(cells, cell_m, settings), 1, constant_values=far)
        penalties = np.where(cells == 0, 0.0, settings.not_free_log_penalty)
        self._penalty = np.pad(penalties, 1, constant_values=settings.not_free_log_penalty)

    def log_weight(self, x: Array, y: Array, heading: Array, hits: Array, exponent: float) -> Array:
        """Of a scan's end points in the robot's frame, with the price of standing in a wall."""
        total = np.zeros(np.broadcast_shapes(x.shape, y.shape, heading.shape))
        c, s = np.cos(heading), np.sin(heading)
        for along, across in hits:
            total += self._at(self._log, x + (c * along - s * across), y + (s * along + c * across))
        return exponent * total + self._at(self._penalty, x, y)

    def _at(self, table: Array, x: Array, y: Array) -> Array:
        col = np.clip(np.floor(x / self._cell_m).astype(int) + 1, 0, table.shape[1] - 1)
        row = np.clip(np.floor(y / self._cell_m).astype(int) + 1, 0, table.shape[0] - 1)
        return table[row, col]


class GridFilter:
    """The belief about a pose as the mass of every (x, y, heading) cell; the masses sum to one."""

    def __init__(self, xs: Array, ys: Array, headings: Array) -> None:
        self.xs, self.ys, self.headings = xs, ys, headings
        self.x, self.y, self.heading = xs[:, None, None], ys[None, :, None], headings
        shape = (len(xs), len(ys), len(headings))
        self.mass = np.full(shape, 1.0 / np.prod(shape))

    @classmethod
    def round_gaussian(
        cls, mean: Array, variances: Array, low: Array, high: Array, cell: Array
    ) -> "GridFilter":
        """A Gaussian with uncorrelated x, y and heading, on a patch from `low` to `high`."""
        made = cls(*(np.arange(*span) for span in zip(low, high, cell, strict=True)))
        at = (made.x, made.y, made.heading)
        squares = sum((a - m) ** 2 / v for a, m, v in zip(at, mean, variances, strict=True))
        made._set(np.exp(-0.5 * squares))
        return made

    def move(self, motion: Array, settings: MotionSettings) -> None:
        """By (dx, dy, turn) in the robot's frame, omnidirectional, with its noise."""
        drive, turn = float(np.hypot(motion[0], motion[1])), float(motion[2])
        by_turn = settings.drive_noise_per_turn * turn
        along_sigma = np.hypot(settings.drive_noise_per_metre * drive, by_turn)
        across_sigma = np.hypot(settings.strafe_noise_per_metre * drive, by_turn)
        turn_sigma = np.hypot(
            settings.turn_noise_per_turn * turn, settings.turn_noise_per_metre * drive
        )
        cell, reach = self.xs[1] - self.xs[0], 5.0 * max(along_sigma, across_sigma) + drive
        count = int(np.ceil(reach / cell))
        dx, dy = np.meshgrid(*[np.arange(-count, count + 1) * cell] * 2, indexing="ij")
        for index, heading in enumerate(self.headings):
            bearing = heading + np.arctan2(motion[1], motion[0])
            along = np.cos(bearing) * dx + np.sin(bearing) * dy - drive
            across = np.cos(bearing) * dy - np.sin(bearing) * dx
            kernel = np.exp(-0.5 * ((along / along_sigma) ** 2 + (across / across_sigma) ** 2))
            kernel /= kernel.sum()
            self.mass[:, :, index] = fftconvolve(self.mass[:, :, index], kernel, mode="same")
        turned = self.headings[:, None] - self.headings[None, :] - turn
        turned -= 2.0 * np.pi * np.round(turned / (2.0 * np.pi))
        turns = np.exp(-0.5 * (turned / turn_sigma) ** 2)
        step = self.headings[1] - self.headings[0]
        turns *= step / (np.sqrt(2.0 * np.pi) * turn_sigma)
        self.mass = np.maximum(self.mass @ turns.T, 0.0)

    def weigh(self, field: ExactField, hits: Array, exponent: float) -> float:
        """Bayes' rule; returns the logarithm of the evidence."""
        likelihood = np.exp(field.log_weight(self.x, self.y, self.heading, hits, exponent))
        evidence = float((self.mass * likelihood).sum())
        self._set(self.mass * likelihood)
        return float(np.log(evidence))

    def gaussian(self) -> tuple[Array, Array]:
        """Mean and covariance of a patch, whose headings do not go round."""
        every = np.meshgrid(self.xs, self.ys, self.headings, indexing="ij")
        poses = np.stack(every, axis=-1).reshape(-1, 3)
        weights = self.mass.ravel()
        mean = weights @ poses
        return mean, (poses - mean).T @ ((poses - mean) * weights[:, None])

    def _set(self, mass: Array) -> None:
        self.mass = mass / mass.sum()


FALSE_ALARMS = 1e-4
"""Probability of a false failure for new seeds; seeds are fixed, so a test is deterministic."""


def assert_is_mean_of(exact: float, values: Sequence[float], grid_error: float) -> None:
    """Compare the mean of independent values with one that is exact but for its grid's cells."""
    mean, count = float(np.mean(values)), len(values)
    error = float(np.std(values, ddof=1)) / count**0.5
    bound = float(students_t.ppf(1.0 - 0.5 * FALSE_ALARMS, count - 1)) * error + grid_error
    assert abs(mean - exact) <= bound, f"mean {mean:.4f}, exact {exact:.4f}, bound {bound:.4f}"
