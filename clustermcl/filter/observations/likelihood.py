"""Likelihoods of observations at many poses, and poses that observations allow."""

import math
from collections.abc import Hashable, Sequence
from dataclasses import replace
from math import floor, hypot, pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from clustermcl.filter.arrays import FREE, LogWeights, Poses
from clustermcl.filter.grid import Grid
from clustermcl.filter.kernels.compiled import ToCells, kernel, plain, to_cells
from clustermcl.filter.laser.sensor_model import ground_log_penalty
from clustermcl.filter.observations.observation import (
    Landmarks,
    Observation,
    factors,
    log_average_ratio,
)
from clustermcl.filter.observations.position_fields import PositionField, ratios
from clustermcl.filter.poses import wrap_angle

_NEGLIGIBLE = 36.0
"""Terms smaller than the largest by more than this are omitted, being below its rounding [nat]."""
_FIELDS_KEPT = 16
"""Fields of one map whose shares of the free space are kept."""
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
    """(F, 3) rows, columns, and index of the first cell in `field_ratios`."""
    field_ratios: NDArray[np.float64]
    """Log ratios of all fields' cells; those of one field end with that of poses outside."""

    @classmethod
    def of(
        cls, observations: Sequence[Observation], landmarks: Landmarks, grid: Grid
    ) -> "ObservationArrays":
        """Return the arrays of observations; arguments as for `log_likelihood_ratio`."""
        names = np.array(landmarks.names)
        detections = [seen for seen in observations if seen.landmark]
        explained = np.empty((len(detections), len(names)))
        for row, seen in zip(explained, detections, strict=True):
            right, any_landmark = factors(seen, landmarks, grid)
            row[:] = any_landmark + right * (names == seen.landmark)
        covariances = np.array([seen.covariance for seen in detections]).reshape(-1, 2, 2, 1)
        xx, xy = covariances[:, 0, 0] + landmarks.variances, covariances[:, 0, 1]
        yy = covariances[:, 1, 1] + landmarks.variances
        determinants = xx * yy - xy * xy
        scales = np.log(explained / (math.tau * np.sqrt(determinants)))
        largest = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)
        poses = [seen for seen in observations if not seen.landmark and seen.field is None]
        rows, precisions = np.zeros((len(poses), 5)), np.zeros((len(poses), 3, 3))
        for row, precision, seen in zip(rows, precisions, poses, strict=True):
            size, (right, _) = len(seen.mean), factors(seen, landmarks, grid)
            row[:size] = seen.mean
            normal = sqrt(float(np.linalg.det(math.tau * seen.covariance)))
            row[3:] = math.log(right / normal), seen.share
            precision[:size, :size] = 0.5 * np.linalg.inv(seen.covariance)
        return cls(
            np.array([(*seen.mean, seen.share) for seen in detections]).reshape(-1, 3),
            plain(landmarks.positions),
            scales,
            np.stack([0.5 * yy, -xy + 0.0 * yy, 0.5 * xx], axis=-1) / determinants[..., None],
            np.sqrt(2.0 * largest * np.maximum(scales + _NEGLIGIBLE, 0.0)),
            rows,
            precisions,
            *_field_arrays(observations, grid),
        )


def _field_arrays(
    observations: Sequence[Observation], grid: Grid
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Return `fields`, `field_cells` and `field_ratios` of observations."""
    rows, sizes, logs, first = [], [], [np.zeros(0)], 0
    for seen in observations:
        if seen.field is not None:
            weights = seen.field.weights(seen.covariance)
            free = free_shares(seen.field, seen.mean, grid)
            rows.append((*seen.mean, 1.0 / seen.field.cell_m, seen.share))
            sizes.append((*weights.shape, first))
            logs.append(np.log(ratios(weights, free, seen.outlier_probability)))
            first += weights.size + 1
    fields, cells = np.array(rows).reshape(-1, 4), np.array(sizes, np.int64).reshape(-1, 3)
    return fields, cells, np.concatenate(logs)


def log_likelihood_ratio(
    poses: Poses, observations: Sequence[Observation], landmarks: Landmarks, grid: Grid
) -> LogWeights:
    """Return (N,) log-likelihoods of poses, relative to "nothing on the map was observed" [nat].

    Args:
        poses: (N, 3) poses of the robot in the map.
        observations: observations of one step.
        landmarks: landmarks of the map.
        grid: the map, over which false observations of the pose are spread.
    """
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
    centres = (np.arange(_NEGLIGIBLE * _PER_NAT) + 0.5) / _PER_NAT
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
    if not apart < _NEGLIGIBLE:  # or NaN, of a pose that is infinitely far
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
    for f in range(len(observed.fields)):
        x, y, per_m, share = observed.fields[f]
        rows, cols, first = observed.field_cells[f]
        for i in range(len(poses)):
            col, row, at = (xs[i] - x) * per_m, (ys[i] - y) * per_m, rows * cols
            if 0.0 <= col < cols and 0.0 <= row < rows:
                at = int(row) * cols + int(col)
            total[i] += share * observed.field_ratios[first + at]
    return total


def allowed_poses(
    observations: Sequence[Observation],
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

    def average(seen: Observation) -> float:
        if seen.field is not None:  # the area that it allows, so that the smallest is the largest
            return -(seen.field.cell_m**2) / float(seen.field.weights(seen.covariance).max())
        return math.expm1(log_average_ratio([replace(seen, share=1.0)], landmarks, grid))

    seen = max(observations, key=average)
    if seen.field is not None:
        return _poses_in_field(seen, seen.field, grid, count, rng)
    poses = rng.uniform(-math.pi, math.pi, (count, 3))
    if seen.landmark:
        right, any_landmark = factors(seen, landmarks, grid)
        odds = any_landmark + right * (np.array(landmarks.names) == seen.landmark)
        chosen = rng.choice(len(odds), count, p=odds / odds.sum())
        spread = rng.normal(size=(count, 2)) * np.sqrt(landmarks.variances[chosen, None])
        x, y = (rng.multivariate_normal(seen.mean, seen.covariance, count) + spread).T
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        from_robot = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        poses[:, :2] = landmarks.positions[chosen] - from_robot
    else:
        poses[:, : len(seen.mean)] = rng.multivariate_normal(seen.mean, seen.covariance, count)
        poses[:, 2] = wrap_angle(poses[:, 2])
    poses = poses[ground_log_penalty(poses, grid, -1.0) == 0.0]
    ratios = np.expm1(log_likelihood_ratio(poses, [replace(seen, share=1.0)], landmarks, grid))
    # Together with poses spread evenly, each is weighed by the density of both.
    return poses, -np.log1p(ratios / average(seen))


def _poses_in_field(
    seen: Observation, field: PositionField, grid: Grid, count: int, rng: np.random.Generator
) -> tuple[Poses, LogWeights]:
    """Return as `allowed_poses`."""
    free = free_shares(field, seen.mean, grid)
    weights = np.where(free > 0.0, field.weights(seen.covariance), 0.0)
    if not weights.any():
        return np.zeros((0, 3)), np.zeros(0)
    shares = weights.ravel() / weights.sum()
    chosen = rng.choice(len(shares), count, p=shares)
    rows, cols = np.divmod(chosen, weights.shape[1])
    poses = rng.uniform(-math.pi, math.pi, (count, 3))
    corners = seen.mean + np.column_stack([cols, rows]) * field.cell_m
    poses[:, :2] = corners + rng.random((count, 2)) * field.cell_m
    is_free = ground_log_penalty(poses, grid, -1.0) == 0.0
    expected = shares[chosen[is_free]] * grid.free_m2 / field.cell_m**2
    return poses[is_free], -np.log1p(expected)


def free_shares(
    field: PositionField, corner: NDArray[np.float64], grid: Grid
) -> NDArray[np.float64]:
    """Return (rows, cols) shares of the map's free space in a field's cells.

    Args:
        field: its cells.
        corner: (2,) its low corner in the map [m].
        grid: the map.
    """
    shape = field.log_likelihoods.shape
    key = (*corner.tolist(), field.cell_m, *shape)
    kept = grid.once("free shares of fields", dict[Hashable, NDArray[np.float64]])
    shares = kept.get(key)
    if shares is None:
        if len(kept) >= _FIELDS_KEPT:
            kept.clear()
        to_field = to_cells(np.append(corner, 0.0), field.cell_m)
        in_map = (*grid.map_from_grid.tolist(), grid.cell_m)
        kept[key] = shares = _free_shares(grid.cells, in_map, to_field, shape)
    return shares


@kernel
def _free_shares(
    cells: NDArray[np.int8],
    in_map: tuple[float, float, float, float],
    to_field: ToCells,
    shape: tuple[int, int],
) -> NDArray[np.float64]:
    shares, total = np.zeros(shape), 0
    x0, y0, heading, cell_m = in_map
    cos, sin, (per_m, _, col0, row0) = math.cos(heading), math.sin(heading), to_field
    for row in range(cells.shape[0]):
        across = (row + 0.5) * cell_m
        for col in range(cells.shape[1]):
            if cells[row, col] != FREE:
                continue
            total += 1
            along = (col + 0.5) * cell_m
            field_col = (x0 + cos * along - sin * across) * per_m + col0
            field_row = (y0 + sin * along + cos * across) * per_m + row0
            if 0.0 <= field_col < shape[1] and 0.0 <= field_row < shape[0]:
                shares[int(field_row), int(field_col)] += 1.0
    return shares / max(total, 1)
