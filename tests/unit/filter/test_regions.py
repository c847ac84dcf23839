import msgspec
import numpy as np
import pytest

from clustermcl.filter.arrays import Pose
from clustermcl.filter.search.regions import is_region, parsed_regions
from clustermcl.filter.settings import SearchSettings


def test_regions_have_names_and_corners() -> None:
    text = "hall: 0 0, 10.5 -5; floor-2: 0 0, 4 0, 4 4;"
    assert msgspec.convert({"regions": text}, SearchSettings).regions == text
    assert parsed_regions(text) == {
        "hall": ((0.0, 0.0), (10.5, -5.0)),
        "floor-2": ((0.0, 0.0), (4.0, 0.0), (4.0, 4.0)),
    }
    assert parsed_regions("") == {}


@pytest.mark.parametrize("text", ["hall", "hall: 1 2", "hall: 1, 2", ": 0 0, 1 1", "a: x 0, 1 1"])
def test_an_unknown_region_is_refused(text: str) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"regions": text}, SearchSettings)


HERE = np.zeros(3)
TURNED = np.array([10.0, 0.0, np.pi / 2])
"""The grid's columns run along the map's y axis from x = 10 on, its rows against the x axis."""
L_SHAPE = ((0.0, 0.0), (5.0, 0.0), (5.0, 1.0), (2.0, 1.0), (2.0, 4.0), (0.0, 4.0))


@pytest.mark.parametrize(
    ("corners", "map_from_grid", "inside"),
    [
        (((1.0, 1.0), (4.0, 3.0)), HERE, [".....", ".###.", ".###.", "....."]),
        (((4.0, 1.0), (1.0, 3.0)), HERE, [".....", ".###.", ".###.", "....."]),
        (L_SHAPE, HERE, ["#####", "##...", "##...", "##..."]),
        (((7.0, 1.0), (9.0, 3.0)), TURNED, [".....", ".##..", ".##..", "....."]),
    ],
    ids=["two corners of a rectangle", "in any order", "a polygon", "a turned grid"],
)
def test_tiles_within_the_corners_are_of_the_region(
    corners: tuple[tuple[float, float], ...], map_from_grid: Pose, inside: list[str]
) -> None:
    """Rows of tiles of 1 m, from the lowest on."""
    tiles = is_region(corners, (4, 5), 1.0, map_from_grid)
    assert ["".join(".#"[int(tile)] for tile in row) for row in tiles] == inside
