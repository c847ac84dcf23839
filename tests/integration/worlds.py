"""Worlds and maps of the tests' robots."""

from pathlib import Path

import numpy as np

from clustermcl.filter.arrays import OCCUPIED
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.steps import MapReading
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.sources import Simulated, parsed_source
from clustermcl.simulator.worlds.catalogue import simulated_world
from clustermcl.simulator.worlds.world import World
from tests.maps import write_map


def world_of(settings: Settings) -> World:
    robot = parsed_source(settings.bridge.source)
    assert isinstance(robot, Simulated)
    return simulated_world(robot)


def map_reading(grid_map: GridMap) -> MapReading:
    """The message in which a robot publishes this map."""
    occupancy = np.where(grid_map.cells == OCCUPIED, 100, grid_map.cells)
    return MapReading(
        sender="robot",
        cell_m=grid_map.cell_m,
        map_from_grid=grid_map.map_from_grid,
        occupancy=ArrayBlob.of(occupancy, "int8"),
    )


def write_room(
    folder: Path,
    name: str = "map",
    *,
    cells: tuple[int, int] = (100, 100),
    cell_m: float = 0.1,
    corner: tuple[float, float] = (0.0, 0.0),
    box: tuple[slice, slice] | None = None,
) -> Path:
    """Write the map of a walled room as map_server has it; return its YAML file."""
    room = np.zeros(cells, np.int8)
    room[[0, -1], :] = room[:, [0, -1]] = OCCUPIED
    if box is not None:
        room[box] = OCCUPIED
    return write_map(GridMap(room, cell_m, (*corner, 0.0)), folder, name)
