from math import atan2, hypot

import numpy as np
import pytest

from clustermcl.filter.arrays import Cells, Points, Pose
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.likelihood_field import LikelihoodField, scan_log_likelihood
from clustermcl.filter.laser.likelihood_field_model import (
    OCCLUSION_MARGIN_M,
    OCCLUSION_SLACK_RAD,
    LikelihoodFieldModel,
)
from clustermcl.filter.laser.sensor_model import Beams
from clustermcl.filter.poses import between, compose
from clustermcl.filter.settings import SensorSettings
from tests.unit.filter.naive_rays import cast_ray
from tests.unit.filter.rooms import CELL_M, plain_room

MAP_FROM_GRID = np.array([-4.0, 7.0, 0.7])
LASER = np.array([0.2, -0.1])


def hidden(pose: Pose, hits: Points, cells: Cells, field: LikelihoodField) -> float:
    """Beam by beam: the field's value, if the ray and both neighbours are blocked earlier."""
    laser, total = compose(pose, np.array([*LASER, 0.0])), 0.0
    for hit in hits:
        x, y, _ = compose(pose, np.array([*hit, 0.0])) - laser
        way_m = hypot(x, y)
        start = between(field.grid.map_from_grid, np.array([*laser[:2], atan2(y, x)]))
        met = [
            cast_ray(cells, CELL_M, start, turn, way_m) < way_m - OCCLUSION_MARGIN_M
            for turn in (0.0, OCCLUSION_SLACK_RAD, -OCCLUSION_SLACK_RAD)
        ]
        if all(met):
            total += scan_log_likelihood(pose[None], hit[None], field)[0] - field.log_floor
    return total


def test_the_kernel_agrees_with_the_rays_one_by_one() -> None:
    rng, cells = np.random.default_rng(5), plain_room()
    grid, settings = Grid(cells, CELL_M, MAP_FROM_GRID), SensorSettings(visibility_beam_stride=1)
    arrays = LikelihoodFieldModel.arrays_of(grid, settings)
    model = LikelihoodFieldModel.from_arrays(grid, arrays, settings)
    size_m = CELL_M * np.array(cells.shape)[::-1]
    inside = np.column_stack((rng.random((20, 2)) * size_m, rng.uniform(-4.0, 4.0, 20)))
    poses = compose(MAP_FROM_GRID, inside)
    x, y = rng.uniform(-4.0, 4.0, (60, 2)).T  # some of them beyond the map
    beams = Beams(np.hypot(x, y), np.arctan2(y, x), np.array([*LASER, 0.0]), 20.0)
    found = model.occluded(poses, beams)
    expected = [hidden(pose, beams.hits_in_robot, cells, model.field) for pose in poses]
    assert max(expected) > 10.0
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)
