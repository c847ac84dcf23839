"""Observations on a floor of a building, and of the floor itself, as observations in the atlas."""

import math

import numpy as np
from msgspec.structs import replace

from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.floors import Floors
from clustermcl.protocol.steps import MAX_FIELD_SIDE, Observation, PositionField

LEAST_CELL_M, MOST_CELL_M = 20.0, 39.0
"""Cells of the field: hardly one on a floor is without free space; none reaches two floors [m]."""
LEAST_PROBABILITY = 1e-6
_EXACT = (1e-6, 0.0, 0.0, 1e-6)


def in_atlas(seen: Observation, floors: Floors) -> Observation:
    """Return an observation whose positions are in the atlas.

    Raises:
        ValueError: it names no floor or an unknown one, or the building is too large for one.
    """
    if seen.floors:
        return _where(seen, floors)
    if seen.landmark or not (floors or seen.floor):
        return seen
    right, up = floors.floor(seen.floor).shift
    x, y, *heading = seen.mean
    return replace(seen, mean=(x + right, y + up, *heading), floor="")


def _where(seen: Observation, floors: Floors) -> Observation:
    """Return probabilities of floors as a field: each cell has that of its floor."""
    said = [(floors.floor(name), p) for name, p in seen.floors.items()]
    low = np.min([floor.low for floor in floors.floors], axis=0)
    width, height = (np.max([floor.high for floor in floors.floors], axis=0) - low).tolist()
    cell_m = max(max(width, height) / MAX_FIELD_SIDE, LEAST_CELL_M)
    if cell_m > MOST_CELL_M:
        raise ValueError(f"a building of {max(width, height):.0f} m is too large to observe floors")
    rows, cols = math.ceil(height / cell_m), math.ceil(width / cell_m)
    middles = (low + (np.array([col, row]) + 0.5) * cell_m for row, col in np.ndindex(rows, cols))
    likely = [
        max((p for floor, p in said if floor.distance_m(x, y) < cell_m / 2), default=0.0)
        for x, y in middles
    ]
    logs = np.log(np.maximum(likely, LEAST_PROBABILITY))
    values = ArrayBlob.of(logs.reshape(rows, cols), "float32")
    x, y = low.tolist()
    return replace(
        seen,
        mean=(x, y),
        covariance=_EXACT,
        field=PositionField(cell_m=cell_m, log_likelihoods=values),
        floors={},
    )
