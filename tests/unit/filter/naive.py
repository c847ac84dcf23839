"""The obvious way to compute what the kernels compute: slow, plain, and easy to check by eye."""

from math import atan2, cos, floor, hypot, pi, sin, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clustermcl.filter.arrays import FREE, OCCUPIED, Cells, LogWeights, Points, Pose, Poses
from clustermcl.filter.grid import Grid
from clustermcl.filter.settings import MotionSettings, SensorSettings
from clustermcl.protocol.message import PoseTuple


def matrix(pose: Pose | PoseTuple) -> NDArray[np.float64]:
    """A pose as a homogeneous matrix: composing is multiplying."""
    c, s = cos(pose[2]), sin(pose[2])
    return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0.0, 0.0, 1.0]])


def angle_between(a: float, b: float) -> float:
    """The unsigned angle between two directions, by their unit vectors."""
    cross, dot = cos(a) * sin(b) - sin(a) * cos(b), cos(a) * cos(b) + sin(a) * sin(b)
    return abs(atan2(cross, dot))


def move(
    poses: Poses, before: Pose, after: Pose, settings: MotionSettings, normals: Poses
) -> Poses:
    x, y = after[0] - before[0], after[1] - before[1]
    turn = atan2(sin(after[2] - before[2]), cos(after[2] - before[2]))
    drive = hypot(x, y)
    bearing = atan2(y, x) - before[2] if drive > 0.0 else 0.0
    motion = (drive, bearing, turn)
    one = _omnidirectional if settings.model == "omnidirectional" else _differential
    return np.array(
        [one(pose, motion, settings, n) for pose, n in zip(poses, normals, strict=True)]
    ).reshape(-1, 3)


def _omnidirectional(
    pose: Pose, motion: tuple[float, float, float], s: MotionSettings, normal: Pose
) -> list[float]:
    drive, bearing, turn = motion
    by_turn = s.drive_noise_per_turn**2 * turn**2
    along = drive + sqrt(s.drive_noise_per_metre**2 * drive**2 + by_turn) * normal[0]
    left = sqrt(s.strafe_noise_per_metre**2 * drive**2 + by_turn) * normal[1]
    turned = turn + normal[2] * sqrt(
        s.turn_noise_per_turn**2 * turn**2 + s.turn_noise_per_metre**2 * drive**2
    )
    direction = pose[2] + bearing
    return [
        pose[0] + along * cos(direction) + left * cos(direction + pi / 2),
        pose[1] + along * sin(direction) + left * sin(direction + pi / 2),
        pose[2] + turned,
    ]


def _differential(
    pose: Pose, motion: tuple[float, float, float], s: MotionSettings, normal: Pose
) -> list[float]:
    drive, bearing, turn = motion
    turn_1 = bearing if drive >= 0.01 else 0.0
    turn_2 = turn - turn_1
    size_1 = min(angle_between(turn_1, 0.0), angle_between(turn_1, pi))
    size_2 = min(angle_between(turn_2, 0.0), angle_between(turn_2, pi))
    by_drive = s.turn_noise_per_metre**2 * drive**2
    turn_1 += sqrt(s.turn_noise_per_turn**2 * size_1**2 + by_drive) * normal[0]
    drive += normal[1] * sqrt(
        s.drive_noise_per_metre**2 * drive**2 + s.drive_noise_per_turn**2 * (size_1**2 + size_2**2)
    )
    turn_2 += sqrt(s.turn_noise_per_turn**2 * size_2**2 + by_drive) * normal[2]
    return [
        pose[0] + drive * cos(pose[2] + turn_1),
        pose[1] + drive * sin(pose[2] + turn_1),
        pose[2] + turn_1 + turn_2,
    ]


def log_field(cells: Cells, cell_m: float, settings: SensorSettings) -> NDArray[np.float64]:
    """Every occupied cell against every cell."""
    rows, cols = np.indices(cells.shape)
    apart = np.full(cells.shape, np.inf)
    for row, col in np.argwhere(cells == OCCUPIED):
        apart = np.minimum(apart, np.hypot(rows - row, cols - col))
    return np.asarray(log_likelihood_at(cell_m * apart, settings))


def log_likelihood_at(distance_m: ArrayLike, s: SensorSettings) -> Any:
    """Table 6.3 of Probabilistic Robotics at a distance, or at many."""
    d = np.minimum(distance_m, s.max_obstacle_distance_m)
    hit = np.exp(-0.5 * (d / s.hit_sigma_m) ** 2) / (sqrt(2 * pi) * s.hit_sigma_m)
    return np.log(s.hit_weight * hit + s.random_weight / s.max_range_m)


def scan_log_likelihood(
    pose: Pose, hits: Points, field: NDArray[np.float64], far: float, grid: Grid
) -> tuple[float, float]:
    """The sum of the field's values, and how near a hit is to the border of its cell [cells]."""
    ends = matrix(pose) @ [*hits.T, np.ones(len(hits))]
    in_cells = (np.linalg.inv(matrix(grid.map_from_grid)) @ ends)[:2].T / grid.cell_m
    values = [_read(field, floor(y), floor(x), far) for x, y in in_cells]
    return sum(values), float(np.abs(in_cells - np.round(in_cells)).min())


def _read(field: NDArray[np.float64], row: int, col: int, far: float) -> float:
    inside = 0 <= row < field.shape[0] and 0 <= col < field.shape[1]
    return float(field[row, col]) if inside else far


def ground_log_penalty(
    poses: Poses, cells: Cells, cell_m: float, map_from_grid: Pose, log_penalty: float
) -> LogWeights:
    field, penalties = np.where(cells == FREE, 0.0, log_penalty), []
    for pose in poses:
        x, y, _ = np.linalg.inv(matrix(map_from_grid)) @ [pose[0], pose[1], 1.0] / cell_m
        penalties.append(_read(field, floor(y), floor(x), log_penalty))
    return np.array(penalties)


def pick(weights: NDArray[np.float64], positions: NDArray[np.float64]) -> NDArray[np.int64]:
    """For each position look along the whole line of weights."""
    line = np.cumsum(weights) / np.sum(weights) * len(positions)
    return np.array([int(np.flatnonzero(line > position)[0]) for position in positions])


def cluster_by_source_point(
    poses: Poses, log_weights: LogWeights, radius_m: float, heading_rad: float, max_clusters: int
) -> tuple[list[int], int]:
    """Every particle against every source, heaviest first."""
    labels, sources = [-1] * len(poses), list[Pose]()
    for i in sorted(range(len(poses)), key=lambda i: -log_weights[i]):
        best = None
        for k, source in enumerate(sources):
            apart = hypot(*(poses[i, :2] - source[:2])) / radius_m
            turned = angle_between(poses[i, 2], source[2]) / heading_rad
            if apart <= 1 and turned <= 1 and (best is None or apart**2 + turned**2 < best[0]):
                best = (apart**2 + turned**2, k)
        if best is not None:
            labels[i] = best[1]
        elif len(sources) < max_clusters:
            labels[i] = len(sources)
            sources.append(poses[i])
    return labels, len(sources)


def fit_gaussian(poses: Poses, weights: NDArray[np.float64]) -> tuple[Pose, NDArray[np.float64]]:
    """Sums, written out."""
    total = sum(weights)
    x = sum(w * p[0] for w, p in zip(weights, poses, strict=True)) / total
    y = sum(w * p[1] for w, p in zip(weights, poses, strict=True)) / total
    heading = atan2(
        sum(w * sin(p[2]) for w, p in zip(weights, poses, strict=True)),
        sum(w * cos(p[2]) for w, p in zip(weights, poses, strict=True)),
    )
    covariance = np.zeros((3, 3))
    for w, pose in zip(weights, poses, strict=True):
        turned = atan2(sin(pose[2] - heading), cos(pose[2] - heading))
        deviation = np.array([pose[0] - x, pose[1] - y, turned])
        covariance += w / total * np.outer(deviation, deviation)
    return np.array([x, y, heading]), covariance
