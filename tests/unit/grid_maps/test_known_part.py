"""A large map costs what is known of it, and poses in it mean what they did."""

import io
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from grid_maps import known_part as module
from grid_maps.known_part import RIM_M, known_part
from grid_maps.ros_image import parse_ros_image
from grid_maps.ros_map import parse_ros_header
from particle_filter.arrays import FREE, OCCUPIED, UNKNOWN, Cells
from particle_filter.poses import compose

CELL_M = 0.1
RIM = round(RIM_M / CELL_M)
HEADER = parse_ros_header(
    b"image: map.png\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\n"
    b"occupied_thresh: 0.65\nfree_thresh: 0.196\n",
    Path("map.yaml"),
)


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


def png(image: Image.Image) -> bytes:
    content = io.BytesIO()
    image.save(content, "png")
    return content.getvalue()


def test_what_is_known_and_a_rim_are_kept() -> None:
    part = known_part(building_in(1000, 1200), CELL_M, (0.0, 0.0, 0.0))
    assert part.cells.shape == (20 + 2 * RIM, 40 + 2 * RIM)
    assert part.map_from_grid == pytest.approx((50.0 - RIM_M, 30.0 - RIM_M, 0.0))
    np.testing.assert_array_equal(part.cells[RIM], building_in(1000, 1200)[300, 450:590])


def test_a_cell_lies_in_the_map_where_it_lay_also_of_a_map_that_is_turned() -> None:
    origin = (-3.0, 7.0, 0.6)
    part = known_part(building_in(1000, 1200), CELL_M, origin)
    row, col = np.argwhere(part.cells == OCCUPIED)[0]
    before = compose(np.array(origin), np.array([500.5 * CELL_M, 300.5 * CELL_M, 0.0]))
    corner = np.array([(col + 0.5) * CELL_M, (row + 0.5) * CELL_M, 0.0])
    np.testing.assert_allclose(compose(np.array(part.map_from_grid), corner), before, atol=1e-9)


def test_the_rim_ends_where_the_map_does() -> None:
    cells = np.full((200, 300), UNKNOWN, np.int8)
    cells[3, :] = FREE
    part = known_part(cells, CELL_M, (1.0, 2.0, 0.0))
    assert part.cells.shape == (3 + 1 + RIM, 300)
    assert part.map_from_grid == (1.0, 2.0, 0.0)


def test_a_small_map_stays_as_it_is() -> None:
    cells = building_in(1000, 1200)[290:330, 480:580]
    assert known_part(cells, CELL_M, (1.0, 2.0, 0.5)).cells.shape == cells.shape


def test_a_large_unknown_map_is_refused() -> None:
    with pytest.raises(ValueError, match="no free cell"):
        known_part(np.full((200, 300), UNKNOWN, np.int8), CELL_M, (0.0, 0.0, 0.0))


def test_a_site_plan_with_one_building_is_read_within_three_copies_of_its_cells() -> None:
    side = 3000
    image = png(grey(building_in(side, side)))
    tracemalloc.start()
    grid_map = parse_ros_image(image, Path("map.png"), HEADER)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert grid_map.cells.shape == (20 + 2 * RIM, 40 + 2 * RIM)
    assert grid_map.cells.base is None  # nothing holds the rest
    # The cells and a mask of them; Pillow's own memory is not seen here.
    assert most < 2.2 * side * side


@pytest.mark.parametrize("corner", [(300, 500), (0, 0), (980, 1160)])
def test_a_grey_image_of_which_only_what_is_known_is_looked_at_is_the_same_map(
    corner: tuple[int, int],
) -> None:
    """As the one in colours, which is looked at everywhere."""
    cells = np.roll(building_in(1000, 1200), (corner[0] - 300, corner[1] - 500), axis=(0, 1))
    maps = [
        parse_ros_image(png(image), Path("map.png"), HEADER)
        for image in (grey(cells), grey(cells).convert("RGB"))
    ]
    assert maps[0].digest == maps[1].digest
