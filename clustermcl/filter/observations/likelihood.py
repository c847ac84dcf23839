"""Likelihoods of observations at many poses, and poses that observations allow."""

import math
from collections.abc import Sequence
from dataclasses import replace
from math import floor, hypot, pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from clustermcl.filter.arrays import LogWeights, Poses
from clustermcl.filter.grid import Grid
from clustermcl.filter.kernels.compiled import kernel, plain
from clustermcl.filter.laser.sensor_model import ground_log_penalty
from clustermcl.filter.observations.kind import NEGLIGIBLE, Kind, Landmarks

_PER_NAT = 32
"""Intervals of the table of log(1 + exp(-d))."""


class ObservationArrays(NamedTuple):
    """The observations of one step as arrays, which all clusters share.

    Each landmark explains an observation with log(ratio) = scale - squares, a Gaussian.
    """

    detections: NDArray[np.float64]
    """(S, 3) x, y of observed landmarks in the robot's frame [m]; share of the observation."""
    positions: NDArray[np.float64]
    """(L, 2) landmarks in the map [m]."""
    scales: NDArray[np.float64]
    """(S, L) log ratio if a landmark is exactly where it is observed."""
    precisions: NDArray[np.float64]
    """(S, L, 3) halves of the precision's xx, of both xy and of yy [1/m^2]."""
    reaches: NDArray[np.float64]
    """(S, L) distance of landmark and observation from which on the ratio is negligible [m]."""
    poses: NDArray[np.float64]
    """(P, 5) poses: x [m], y [m], heading [rad], scale, share."""
    pose_precisions: NDArray[np.float64]
    """(P, 3, 3) halves of the precisions of the poses; 0 of an unknown heading."""
    fields: NDArray[np.float64]
    """(F, 4) fields: x, y of the low corner [m]; cells per metre; share."""
    field_cells: NDArray[np.int64]
    """(F, 2) rows and columns."""
    field_ratios: NDArray[np.float64]
    """Log ratios of all fields' cells; those of one field end with that of poses outside."""

    @classmethod
    def of(
        cls, observations: Sequence[Kind], landmarks: Landmarks, grid: Grid
    ) -> "ObservationArrays":
        """Return the arrays of observations; arguments as for `log_likelihood_ratio`."""
        marks = len(landmarks.names)
        shapes = (0, 3), (0, 2), (0, marks), (0, marks, 3), (0, marks), (0, 5), (0, 3, 3), (0, 4)
        none = (np.zeros(shape) for shape in (*shapes, 0, 0))
        first = dict(zip(cls._fields, none, strict=True)) | {"positions": landmarks.positions}
        first["field_cells"] = np.zeros((0, 2), np.int64)
        rows = [first, *(each.arrays(landmarks, grid) for each in observations)]
        joined = (
            np.concatenate([each[name] for each in rows if name in each]) for name in cls._fields
        )
        return cls(*map(np.ascontiguousarray, joined))


def log_likelihood_ratio(
    poses: Poses, observations: Sequence[Kind], landmarks: Landmarks, grid: Grid
) -> LogWeights:
    """Return (N,) log ratios of (N, 3) poses to "nothing on the map was observed" [nat]."""
    return log_ratios(poses, ObservationArrays.of(observations, landmarks, grid))


def log_ratios(poses: Poses, observed: ObservationArrays) -> LogWeights:
    """Return the same as `log_likelihood_ratio`, from the arrays of the observations."""
    if not len(poses):
        return np.zeros(0)
    return _log_ratios(plain(poses), observed, _LOG_TABLE)


def _log_table() -> NDArray[np.float64]:
    """Return (intervals, 6) Taylor polynomials of log(1 + exp(-d)) around intervals' centres.

    With s = 1 / (1 + exp(d)), the derivatives are polynomials of s: -s, and ds/dd = s^2 - s.
    """
    centres = (np.arange(NEGLIGIBLE * _PER_NAT) + 0.5) / _PER_NAT
    s = 1.0 / (1.0 + np.exp(centres))
    columns, derivative = [np.log1p(np.exp(-centres))], Polynomial([0.0, -1.0])
    for degree in range(1, 6):
        columns.append(derivative(s) / math.factorial(degree))
        derivative = derivative.deriv() * Polynomial([0.0, -1.0, 1.0])
    return np.stack(columns, axis=-1)


_LOG_TABLE = _log_table()


@kernel
def _log_add(a: float, b: float, table: NDArray[np.float64]) -> float:
    """Return log(exp(a) + exp(b)), with an error below 1e-14; four times as fast as libm's."""
    larger, apart = b if b > a else a, abs(a - b)
    if not apart < NEGLIGIBLE:  # or NaN, of a pose that is infinitely far
        return larger
    row = np.int32(apart * _PER_NAT)
    off, at = apart - (row + 0.5) * (1.0 / _PER_NAT), np.uint32(row)  # no check of the sign
    far = table[at, 3] + off * (table[at, 4] + off * table[at, 5])
    near = table[at, 0] + off * (table[at, 1] + off * (table[at, 2] + off * far))
    return float(larger + near)


@kernel
def _log_ratios(
    poses: Poses, observed: ObservationArrays, table: NDArray[np.float64]
) -> LogWeights:
    xs, ys = poses[:, 0].copy(), poses[:, 1].copy()
    cosines, sines = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x0, y0, cos0, sin0 = xs.mean(), ys.mean(), cosines.mean(), sines.mean()
    around, chord = 0.0, 0.0  # bounds of the differences from the mean, squared
    for i in range(len(poses)):
        around = max(around, (xs[i] - x0) ** 2 + (ys[i] - y0) ** 2)
        chord = max(chord, (cosines[i] - cos0) ** 2 + (sines[i] - sin0) ** 2)
    around, chord = sqrt(around), sqrt(chord)
    total, log_sum, log_ratio = np.zeros(len(poses)), np.empty(len(poses)), np.empty(len(poses))
    for s in range(len(observed.detections)):
        x, y, share = observed.detections[s]
        here_x, here_y = x0 + cos0 * x - sin0 * y, y0 + sin0 * x + cos0 * y
        apart = around + chord * hypot(x, y)
        log_sum[:] = 0.0  # the logarithm of 1 and all terms so far
        for mark in range(len(observed.positions)):
            mark_x, mark_y = observed.positions[mark]
            if hypot(mark_x - here_x, mark_y - here_y) > apart + observed.reaches[s, mark]:
                continue
            scale, (xx, xy, yy) = observed.scales[s, mark], observed.precisions[s, mark]
            for i in range(len(poses)):  # a loop of its own, which is compiled to vectors
                east, north = mark_x - xs[i], mark_y - ys[i]
                ahead = cosines[i] * east + sines[i] * north - x
                left = cosines[i] * north - sines[i] * east - y
                log_ratio[i] = scale - (xx * ahead * ahead + xy * ahead * left + yy * left * left)
            for i in range(len(poses)):
                log_sum[i] = _log_add(log_sum[i], log_ratio[i], table)
        for i in range(len(poses)):
            total[i] += share * log_sum[i]
    for p in range(len(observed.poses)):
        x, y, heading, scale, share = observed.poses[p]
        a = observed.pose_precisions[p]
        for i in range(len(poses)):
            dx, dy, turn = xs[i] - x, ys[i] - y, poses[i, 2] - heading
            turn -= 2.0 * pi * floor(turn / (2.0 * pi) + 0.5)
            squares = a[0, 0] * dx * dx + a[1, 1] * dy * dy + a[2, 2] * turn * turn
            mixed = a[0, 1] * dx * dy + a[0, 2] * dx * turn + a[1, 2] * dy * turn
            total[i] += share * _log_add(0.0, scale - squares - 2.0 * mixed, table)
    first = 0  # of the field's cells in `field_ratios`
    for f in range(len(observed.fields)):
        x, y, per_m, share = observed.fields[f]
        rows, cols = observed.field_cells[f]
        for i in range(len(poses)):
            col, row, at = (xs[i] - x) * per_m, (ys[i] - y) * per_m, rows * cols
            if 0.0 <= col < cols and 0.0 <= row < rows:
                at = int(row) * cols + int(col)
            total[i] += share * observed.field_ratios[first + at]
        first += rows * cols + 1
    return total


def allowed_poses(
    observations: Sequence[Kind],
    landmarks: Landmarks,
    grid: Grid,
    count: int,
    rng: np.random.Generator,
) -> tuple[Poses, LogWeights]:
    """Draw poses that the most informative observation allows.

    Returns:
        At most (count, 3) poses in the free space; and their log weights: `count` times the average
        of weight times a function estimates the part of its average over the free space that the
        observation explains.
    """

    seen = max(observations, key=lambda each: each.informativeness(landmarks, grid))
    poses = seen.draw(landmarks, grid, count, rng)
    poses = poses[ground_log_penalty(poses, grid, -1.0) == 0.0]
    excess = np.expm1(log_likelihood_ratio(poses, [replace(seen, share=1.0)], landmarks, grid))
    # Together with poses spread evenly, each is weighed by the density of both.
    return poses, -np.log1p(seen.density(poses, excess, landmarks, grid))
