"""Which look-alike places stay ambiguous, wherever the robot drives from there?"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from clustermcl.filter.advice.advice import Question, advised_ways, cast
from clustermcl.filter.advice.roads import LEAST_REACH_M
from clustermcl.filter.arrays import Poses
from clustermcl.filter.cluster.view_memory import ViewMemory
from clustermcl.filter.kernels.compiled import plain
from clustermcl.filter.laser.sensor_model import LaserScan, SensorModel
from clustermcl.filter.laser.sensor_models import computed_model
from clustermcl.filter.observations.kind import Landmarks
from clustermcl.filter.settings import FilterSettings
from clustermcl.recordings.maps.grid_map import GridMap

_MOST_GROUPS, _MOST_PLACES = 12, 16
_RADIUS_M, _GATE_M, _GATE_RAD = 0.2, 0.2, 0.2
_BEAMS = 360
_LEAST_INFORMATION = 0.1
"""Of one view [nat]; less is an error of the poses or of the map's cells."""
_NEAR = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 7)] * 3), axis=-1).reshape(-1, 3)
_NEAR = _NEAR[np.square(_NEAR).sum(axis=1).argsort(kind="stable")] * (0.05, 0.05, 0.02)
"""Of poses that fit equally well, the nearest one is taken."""
_KNOWN = np.diag([0.05, 0.05, 0.01]) ** 2


def distinguishable(
    groups: Sequence[Poses], grid_map: GridMap, range_m: float
) -> list[bool | None]:
    """Return for each group of look-alike places whether advised ways distinguish some of them.

    Each group has (K, 3) poses in the map, of which the first 16 are compared. None: one place
    only, the robot has no room for a way, or there are 12 groups before this one.
    """
    asked = [number for number, group in enumerate(groups) if len(group) > 1][:_MOST_GROUPS]
    answers: list[bool | None] = [None] * len(groups)
    if not asked:
        return answers
    settings = FilterSettings()
    model = computed_model(grid_map.grid, settings.sensor)
    rows = ((each.name, each.x, each.y, each.sigma) for each in grid_map.landmarks)
    landmarks, step = Landmarks.of(rows), 2.0 * np.pi / _BEAMS
    laser = LaserScan(np.ones(_BEAMS), range_m, -np.pi, step, np.zeros(3))
    for number in asked:
        places = _aligned(groups[number][:_MOST_PLACES], laser, model)
        count = len(places)
        question = Question(
            places, np.array([_KNOWN] * count), np.full(count, 1.0 / count), laser, 0.0,
            _RADIUS_M, ViewMemory(), _GATE_M, _GATE_RAD, landmarks,
        )  # fmt: skip
        _, spots = advised_ways(question, model, settings)
        if np.hypot(spots[:, 0], spots[:, 1]).max() >= LEAST_REACH_M:
            answers[number] = bool(spots[:, 2].max() >= _LEAST_INFORMATION)
    return answers


def _aligned(places: Poses, laser: LaserScan, model: SensorModel) -> Poses:
    """Move the other places until the first one's scan fits best, as tracking would."""
    seen = replace(laser, ranges=cast(places[:1], laser, model)[0])
    beams, aligned = model.beams(seen), places.copy()
    for size in (1.0, 0.3) if beams.count else ():
        for i in range(1, len(places)):
            near = plain(aligned[i] + size * _NEAR)
            aligned[i] = near[int(model.log_likelihood(near, beams).argmax())]
    return aligned
