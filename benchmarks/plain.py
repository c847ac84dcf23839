"""The kernels' work in plain numpy, as one writes it first."""

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import LogWeights, Points, Poses
from clustermcl.filter.laser.likelihood_field import LikelihoodField


def scan_log_likelihood(
    poses: Poses, hits: Points, field: LikelihoodField, block: int = 2_000
) -> NDArray[np.float64]:
    """In blocks of particles, so that the intermediate numbers stay small."""
    rows, cols = field.codes.shape
    total = np.empty(len(poses))
    for start in range(0, len(poses), block):
        x, y, heading = poses[start : start + block].T[:, :, None]
        c, s = np.cos(heading), np.sin(heading)
        col = (x + c * hits[:, 0] - s * hits[:, 1]) / field.grid.cell_m + 1.0
        row = (y + s * hits[:, 0] + c * hits[:, 1]) / field.grid.cell_m + 1.0
        np.clip(col, 0, cols - 1, out=col)
        np.clip(row, 0, rows - 1, out=row)
        codes = field.codes[row.astype(np.int64), col.astype(np.int64)]
        total[start : start + block] = codes.sum(axis=1, dtype=np.int64)
    return len(hits) * field.log_floor + field.log_step * total


def drive(
    poses: Poses, motion: NDArray[np.float64], noise: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Bearing, drive, turn and three standard deviations; (3, N) standard normal numbers."""
    along = motion[1] + motion[3] * noise[0]
    across = motion[4] * noise[1]
    direction = poses[:, 2] + motion[0]
    heading = poses[:, 2] + motion[2] + motion[5] * noise[2]
    return np.stack(
        [
            poses[:, 0] + along * np.cos(direction) - across * np.sin(direction),
            poses[:, 1] + along * np.sin(direction) + across * np.cos(direction),
            (heading + np.pi) % (2.0 * np.pi) - np.pi,
        ],
        axis=-1,
    )


def resample(log_weights: NDArray[np.float64], first: float) -> NDArray[np.int64]:
    """Systematic."""
    weights = np.exp(log_weights - log_weights.max())
    line = np.cumsum(weights / weights.sum())
    return np.searchsorted(line, (np.arange(len(line)) + first) / len(line))


def fit_gaussian(
    poses: Poses, weights: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Of headings near their mean."""
    heading = np.arctan2(weights @ np.sin(poses[:, 2]), weights @ np.cos(poses[:, 2]))
    mean = np.array([*(weights @ poses[:, :2]), heading])
    off = poses - mean
    off[:, 2] = (off[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    return mean, (off * weights[:, None]).T @ off


def cast_rays(
    clear_cells: NDArray[np.float32],
    cell_m: float,
    poses: Poses,
    directions: Points,
    max_range_m: float,
) -> NDArray[np.float64]:
    """All rays march at once over a field of distances; not exact, by half a cell."""
    c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    dx = (c * directions[:, 0] - s * directions[:, 1]).ravel()
    dy = (s * directions[:, 0] + c * directions[:, 1]).ravel()
    x, y = np.repeat(poses[:, :2].T / cell_m, len(directions), axis=1)
    t, going = np.zeros(len(dx)), np.arange(len(dx))
    rows, cols = clear_cells.shape
    while len(going):
        col = (x[going] + t[going] * dx[going]).astype(np.int64).clip(0, cols - 1)
        row = (y[going] + t[going] * dy[going]).astype(np.int64).clip(0, rows - 1)
        clear = clear_cells[row, col]
        t[going] += np.where(clear > 0.0, np.maximum(clear * 0.999, 1.0), 0.0)
        going = going[(clear > 0.0) & (t[going] < max_range_m / cell_m)]
    return np.minimum(t * cell_m, max_range_m).reshape(len(poses), len(directions))


def updated_belief(
    prior: NDArray[np.float64], log_likelihood: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Bayes' rule over clusters."""
    posterior = prior * np.exp(log_likelihood - log_likelihood.max())
    return posterior / posterior.sum()


def cluster_by_source_point(
    poses: Poses, log_weights: LogWeights, radius_m: float, heading_rad: float, max_clusters: int
) -> NDArray[np.int64]:
    """(N,) labels: one source after the other, each compared with all particles at once."""
    order = np.argsort(-log_weights, kind="stable")
    ordered = poses[order]
    labels, nearest = np.full(len(poses), -1), np.full(len(poses), np.inf)
    for cluster in range(max_clusters):
        unlabelled = np.flatnonzero(labels < 0)
        if len(unlabelled) == 0:
            break
        offsets = ordered - ordered[unlabelled[0]]
        apart = (offsets[:, 0] ** 2 + offsets[:, 1] ** 2) / radius_m**2
        turns = offsets[:, 2] / (2.0 * np.pi)
        turned = (turns - np.floor(turns + 0.5)) * 2.0 * np.pi / heading_rad
        distance = apart + turned**2
        nearer = (apart <= 1.0) & (np.abs(turned) <= 1.0) & (distance < nearest)
        nearer[: unlabelled[0]] = False  # they were there before the source was
        labels[nearer], nearest[nearer] = cluster, distance[nearer]
    in_place = np.empty_like(labels)
    in_place[order] = labels
    return in_place
