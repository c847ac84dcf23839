"""Does a recording agree with a map: is the robot found in it, and do its scans fit there?"""

import itertools
from collections.abc import Iterable

import msgspec
import numpy as np
from scipy.ndimage import distance_transform_edt

from evaluation import in_process
from evaluation.map_check.mount import Mount, mount_of
from evaluation.map_check.refining import refined
from grid_maps.grid_map import GridMap
from particle_filter.arrays import OCCUPIED, Points, Poses
from particle_filter.likelihood_field import LikelihoodField
from particle_filter.poses import compose, inverse
from particle_filter.sensor_model import Grid
from particle_filter.sensor_models import computed_model
from particle_filter.settings import FilterSettings
from protocol.steps import Scan
from worker.scan_beams import scan_beams

FITS_WITHIN_M = 0.2
MOST_STEPS = 400
"""Of a recording: a minute's work, and enough to tell."""


class Agreement(msgspec.Struct, frozen=True, kw_only=True):
    """What came of localizing with a recording."""

    steps: int
    localized_share: float
    """Of the steps."""
    fitting_share: float | None
    """Of the beams at localized steps, those that end within 0.2 m of an obstacle of the map."""
    told_mount: tuple[float, float, float]
    """`robot_from_laser`, as the recording or the settings say."""
    mount: Mount | None
    """What the map says of it; None: too few localized steps, or too few turns, to tell."""


def agreement_of(scans: Iterable[Scan], grid_map: GridMap, settings: FilterSettings) -> Agreement:
    """Localize with the first steps of a recording, and compare its scans with the map.

    Args:
        scans: all steps; at least one.
        grid_map: the map.
        settings: of the filter.
    """
    grid = Grid(grid_map.cells, grid_map.cell_m, np.array(grid_map.map_from_grid))
    model = computed_model(grid, settings.sensor)
    field = LikelihoodField.build(
        grid_map.cells, grid_map.cell_m, np.array(grid_map.map_from_grid), settings.sensor
    )
    rng = np.random.default_rng(settings.seed)
    run: list[tuple[Poses, Poses]] = []
    longest: list[tuple[Poses, Poses]] = []
    fitting: list[float] = []
    steps, localized, told = 0, 0, (0.0, 0.0, 0.0)
    to_obstacle_m = _distances_m(grid_map)
    for scan, outcome in in_process.outcomes(itertools.islice(scans, MOST_STEPS), model, settings):
        steps, told = steps + 1, scan.robot_from_laser
        beams = scan_beams(scan, model)
        if outcome.state != "localized" or not beams.count:
            run = []
            continue
        localized += 1
        best = np.array([outcome.hypotheses[0].mean])
        poses, _ = refined(best, beams.hits_in_robot, field, rng)
        fitting.append(_fitting_share(poses[0], beams.hits_in_robot, grid_map, to_obstacle_m))
        run.append((compose(poses[0], np.array(told)), np.array(scan.odom_from_robot)))
        longest = max(longest, run, key=len)
    found = np.array(longest).reshape(-1, 2, 3)
    return Agreement(
        steps=steps,
        localized_share=localized / max(steps, 1),
        fitting_share=float(np.mean(fitting)) if fitting else None,
        told_mount=told,
        mount=mount_of(found[:, 0], found[:, 1]),
    )


def _distances_m(grid_map: GridMap) -> np.ndarray:
    """(rows, cols) from each cell to the nearest obstacle [m]."""
    return np.asarray(distance_transform_edt(grid_map.cells != OCCUPIED) * grid_map.cell_m)


def _fitting_share(
    map_from_robot: Poses, hits_in_robot: Points, grid_map: GridMap, to_obstacle_m: np.ndarray
) -> float:
    hits = np.column_stack([hits_in_robot, np.zeros(len(hits_in_robot))])
    in_map = compose(map_from_robot, hits)
    in_grid = compose(inverse(np.array(grid_map.map_from_grid)), in_map)
    cols, rows = np.floor(in_grid[:, :2] / grid_map.cell_m).astype(int).T
    height, width = to_obstacle_m.shape
    inside = (rows >= 0) & (cols >= 0) & (rows < height) & (cols < width)
    near = to_obstacle_m[rows[inside], cols[inside]] <= FITS_WITHIN_M
    return float(np.count_nonzero(near) / len(hits))
