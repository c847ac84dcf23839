import numpy as np
import pytest
from numpy.typing import NDArray

from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.simulator.free_space import FreeSpace
from clustermcl.simulator.worlds.catalogue import WORLDS, world
from clustermcl.simulator.worlds.world import UnknownWorldError, world_from_map


def unlike_when_turned(grid_map: GridMap, times: int) -> NDArray[np.bool_]:
    """Cells that some turn by 1 / `times` of a full turn changes."""
    turns = range(4 // times, 4, 4 // times)
    turned = [np.rot90(grid_map.cells, quarters) for quarters in turns]
    return np.asarray(np.any([grid_map.cells != cells for cells in turned], axis=0))


@pytest.mark.parametrize("name", WORLDS)
def test_every_world_is_walled_in_and_has_room_for_the_robot(name: str) -> None:
    somewhere = world(name)
    cells = somewhere.truth.cells
    assert set(np.unique(cells)) == {FREE, OCCUPIED, UNKNOWN}
    for axis in (0, 1):  # every way out crosses a wall
        ahead = np.roll(cells, 1, axis)
        assert not np.any((cells == FREE) & (ahead == UNKNOWN))
        assert not np.any((cells == UNKNOWN) & (ahead == FREE))
    FreeSpace(somewhere.truth)


@pytest.mark.parametrize(("name", "times"), [("cross", 4), ("hall_symmetric", 2)])
def test_symmetric_worlds_are_symmetric_to_the_last_cell(name: str, times: int) -> None:
    assert not unlike_when_turned(world(name).map, times).any()


def test_the_cross_differs_from_its_turned_self_by_one_cabinet() -> None:
    plain, unlike = world("cross").map.cells, world("cross_feature").map.cells
    rows, cols = np.nonzero(plain != unlike)
    cabinet_m2 = 1.4 * 1.0
    assert len(rows) == (np.ptp(rows) + 1) * (np.ptp(cols) + 1)
    assert len(rows) * 0.05**2 == pytest.approx(cabinet_m2)


def test_a_map_makes_a_world_that_equals_it() -> None:
    grid_map = GridMap(np.zeros((40, 40), np.int8), 0.1, (1.0, 2.0, 0.5))
    somewhere = world_from_map(grid_map)
    assert somewhere.map is somewhere.truth is grid_map
    with pytest.raises(UnknownWorldError, match="'moon'; the worlds are cross"):
        world("moon")
