"""The likelihood field: how well a scan's end points lie on the map's obstacles."""

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np

from particle_filter.arrays import FREE, OCCUPIED, Cells, LogField, LogWeights, Points, Pose, Poses
from particle_filter.kernels import kernel
from particle_filter.poses import compose, inverse
from particle_filter.settings import SensorSettings


def log_field(cells: Cells, cell_m: float, settings: SensorSettings) -> LogField:
    """Log-likelihood of a beam that ends in each cell.

    log(hit_weight * N(d; 0, hit_sigma_m) + random_weight / max_range_m) [1/m], where d is the
    distance to the nearest occupied cell, capped at `max_obstacle_distance_m`. A true density,
    so that the logarithms of beams add; unknown cells are as far as they are.

    Args:
        cells: (rows, cols) grid; row 0 has the lowest y.
        cell_m: side of a cell [m].
        settings: the sensor model's numbers.

    Returns:
        (rows, cols).

    Raises:
        ValueError: no cell is occupied; every pose would fit equally well.

    References:
        Probabilistic Robotics (2005), table 6.3, lines 6 and 7, in logarithms.
    """
    from scipy.ndimage import distance_transform_edt  # noqa: PLC0415 - heavy, once per map

    empty = cells != OCCUPIED
    if empty.all():
        raise ValueError("the map has no occupied cell to compare a scan with")
    distance_m = distance_transform_edt(empty).astype(np.float32)
    distance_m *= np.float32(cell_m)
    np.minimum(distance_m, np.float32(settings.max_obstacle_distance_m), out=distance_m)
    peak = settings.hit_weight / (sqrt(2.0 * pi) * settings.hit_sigma_m)
    likelihood = np.float32(peak) * np.exp(-0.5 * (distance_m / settings.hit_sigma_m) ** 2)
    likelihood += np.float32(settings.random_weight / settings.max_range_m)
    return np.asarray(np.log(likelihood), np.float32)


@dataclass(frozen=True, eq=False)
class LikelihoodField:
    """A map made ready for scoring. Plain arrays: they may be mapped from a file and shared."""

    table: LogField
    """(rows + 2, cols + 2) log-likelihoods; the rim around the map is far from everything."""
    cell_m: float
    map_from_grid: Pose
    """(3,) the outer corner of cell (0, 0), in the map's frame."""

    @classmethod
    def build(
        cls, cells: Cells, cell_m: float, map_from_grid: Pose, settings: SensorSettings
    ) -> "LikelihoodField":
        """Compute the field of a map; see `log_field` for arguments and errors."""
        inside = log_field(cells, cell_m, settings)
        table = np.pad(inside, 1, constant_values=_far(settings))
        return cls(table=table, cell_m=cell_m, map_from_grid=map_from_grid)


def scan_log_likelihood(
    map_from_robot: Poses, hits_in_robot: Points, field: LikelihoodField
) -> LogWeights:
    """Weigh every particle by how well the scan fits the map from its pose.

    Each beam's end point is carried into the map and reads the field there. Beams are
    taken as independent, so logarithms add. A hit outside the map is far from everything.

    Args:
        map_from_robot: (N, 3) poses.
        hits_in_robot: (B, 2) end points of the beams that returned [m].
        field: the map.

    Returns:
        (N,) log-likelihood of the scan for each particle, not normalised.

    Raises:
        ValueError: no beam returned; a sum over nothing would call all poses equally good.

    References:
        Probabilistic Robotics (2005), table 6.3, in logarithms: 180 densities underflow.
    """
    if len(hits_in_robot) == 0:
        raise ValueError("the scan has no returns to score")
    grid_from_robot = compose(inverse(field.map_from_grid), map_from_robot)
    return _sum_at_hits(grid_from_robot, hits_in_robot, field.table, 1.0 / field.cell_m)


def ground_log_penalty(
    map_from_robot: Poses, cells: Cells, cell_m: float, map_from_grid: Pose, log_penalty: float
) -> LogWeights:
    """What each particle pays for the ground it stands on.

    Args:
        map_from_robot: (N, 3) poses.
        cells: (rows, cols) grid; row 0 has the lowest y.
        cell_m: side of a cell [m].
        map_from_grid: (3,) the outer corner of cell (0, 0), in the map's frame.
        log_penalty: for ground that is occupied, unknown or off the map.

    Returns:
        (N,) `log_penalty` or 0.
    """
    grid_from_robot = compose(inverse(map_from_grid), map_from_robot)
    # Not int(): it rounds towards zero and counts cells just below the map as inside.
    cols = np.floor(grid_from_robot[:, 0] / cell_m)
    rows = np.floor(grid_from_robot[:, 1] / cell_m)
    inside = (cols >= 0) & (cols < cells.shape[1]) & (rows >= 0) & (rows < cells.shape[0])
    penalties = np.full(len(map_from_robot), log_penalty)
    free = cells[rows[inside].astype(np.int64), cols[inside].astype(np.int64)] == FREE
    penalties[np.flatnonzero(inside)[free]] = 0.0
    return penalties


def _far(settings: SensorSettings) -> float:
    peak = settings.hit_weight / (sqrt(2.0 * pi) * settings.hit_sigma_m)
    deviations = settings.max_obstacle_distance_m / settings.hit_sigma_m
    hit = peak * np.exp(-0.5 * deviations**2)
    return float(np.log(hit + settings.random_weight / settings.max_range_m))


@kernel
def _sum_at_hits(poses: Poses, hits: Points, table: LogField, cells_per_m: float) -> LogWeights:
    last_row, last_col = table.shape[0] - 0.5, table.shape[1] - 0.5
    totals = np.zeros(len(poses))
    for i in range(len(poses)):
        c, s = np.cos(poses[i, 2]) * cells_per_m, np.sin(poses[i, 2]) * cells_per_m
        x0, y0 = poses[i, 0] * cells_per_m + 1.0, poses[i, 1] * cells_per_m + 1.0
        total = 0.0
        for j in range(len(hits)):
            x = x0 + c * hits[j, 0] - s * hits[j, 1]  # table 6.3, line 5
            y = y0 + s * hits[j, 0] + c * hits[j, 1]  # table 6.3, line 6
            # Clamped to the rim before int(): of a far pose, compiled int() is an overflow.
            col = int(max(min(x, last_col), 0.0))
            row = int(max(min(y, last_row), 0.0))
            total += table[row, col]
        totals[i] = total
    return totals
