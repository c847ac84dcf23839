import msgspec
import numpy as np
import pytest

from particle_filter.regions import is_region, parsed_regions
from particle_filter.settings import SearchSettings

HERE = np.zeros(3)


def inside(corners: tuple[tuple[float, float], ...], map_from_grid: np.ndarray = HERE) -> list[str]:
    """Rows of tiles of 1 m, from the lowest on."""
    return [
        "".join(".#"[int(tile)] for tile in row)
        for row in is_region(corners, (4, 5), 1.0, map_from_grid)
    ]


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


def test_two_corners_are_those_of_a_rectangle_in_any_order() -> None:
    for corners in (((1.0, 1.0), (4.0, 3.0)), ((4.0, 1.0), (1.0, 3.0))):
        assert inside(corners) == [".....", ".###.", ".###.", "....."]


def test_more_than_two_corners_define_a_polygon() -> None:
    l_shape = ((0.0, 0.0), (5.0, 0.0), (5.0, 1.0), (2.0, 1.0), (2.0, 4.0), (0.0, 4.0))
    assert inside(l_shape) == ["#####", "##...", "##...", "##..."]


def test_a_region_lies_in_the_map_also_where_the_grid_is_turned() -> None:
    # The grid's columns run along the map's y axis from x = 10 on, its rows against the x axis.
    turned = np.array([10.0, 0.0, np.pi / 2])
    assert inside(((7.0, 1.0), (9.0, 3.0)), turned) == [".....", ".##..", ".##..", "....."]
