import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN, Cells
from clustermcl.filter.poses import compose
from clustermcl.recordings.maps import grid_map as module
from clustermcl.recordings.maps.grid_map import RIM_M, GridMap, known_part
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.runtime import compressed
from tests.maps import header

CELL_M = 0.1
RIM = round(RIM_M / CELL_M)


@pytest.fixture(autouse=True)
def small_is_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LARGE_CELLS", 10_000)


def building_in(rows: int, cols: int) -> Cells:
    cells = np.full((rows, cols), UNKNOWN, np.int8)
    cells[300:320, 500:540] = FREE
    cells[300, 500:540] = OCCUPIED
    return cells


def grey(cells: Cells) -> Image.Image:
    return Image.fromarray(np.array([254, 0, 205], np.uint8)[cells][::-1])


def loaded(folder: Path, image: Image.Image) -> GridMap:
    image.save(folder / "map.png")
    (folder / "map.yaml").write_text(header(image="map.png", resolution="0.1"))
    return load_map(folder / "map.yaml")


def test_a_large_map_is_cropped_to_its_known_cells_and_a_rim() -> None:
    origin = (-3.0, 7.0, 0.6)
    part = known_part(building_in(1000, 1200), CELL_M, origin)
    assert part.cells.shape == (20 + 2 * RIM, 40 + 2 * RIM)
    corner = compose(np.array(origin), np.array([50.0 - RIM_M, 30.0 - RIM_M, 0.0]))
    assert part.map_from_grid == pytest.approx(tuple(corner)), "each cell keeps its place"
    np.testing.assert_array_equal(part.cells[RIM], building_in(1000, 1200)[300, 450:590])


def test_the_rim_ends_at_the_edge_of_the_map_and_a_small_map_is_not_cropped() -> None:
    cells = np.full((200, 300), UNKNOWN, np.int8)
    cells[3, :] = FREE
    part = known_part(cells, CELL_M, (1.0, 2.0, 0.0))
    assert part.cells.shape == (3 + 1 + RIM, 300)
    assert part.map_from_grid == (1.0, 2.0, 0.0)
    assert known_part(cells, 1e-320, (0.0, 0.0, 0.0)).cells.shape == cells.shape
    with pytest.raises(ValueError, match="no cell is free"):
        known_part(np.full((200, 300), UNKNOWN, np.int8), CELL_M, (0.0, 0.0, 0.0))
    small = building_in(1000, 1200)[290:330, 480:580]
    assert known_part(small, CELL_M, (1.0, 2.0, 0.5)).cells.shape == small.shape


def test_reading_a_site_plan_needs_less_memory_than_three_copies_of_its_cells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A buffer of this size is reserved for a file, but not filled.
    monkeypatch.setattr(compressed, "MAX_FILE_BYTES", 2**20)
    side = 3000
    image = grey(building_in(side, side))
    loaded(tmp_path, image)
    tracemalloc.start()
    grid_map = loaded(tmp_path, image)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert grid_map.cells.shape == (20 + 2 * RIM, 40 + 2 * RIM)
    assert grid_map.cells.base is None  # a view would keep all cells in memory
    # The cells and a mask of them; Pillow's own memory is not seen here.
    assert most < 2.2 * side * side
