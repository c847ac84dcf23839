from typing import Any

import numpy as np
import pytest

from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.view.drawing import PALETTE, drawn_picture, percent

WHITE, GREY, DARK = (255, 255, 255), (227, 230, 234), (42, 50, 59)
CELL_M, MARGIN = 0.5, 24


def room(*, turned: float = 0.0) -> GridMap:
    """20 m wide, 10 m high; the low right quarter is a wall."""
    cells = np.zeros((20, 40), np.int8)
    cells[:10, 20:] = 1
    return GridMap(cells, CELL_M, (-4.0, 2.0, turned))


def step(**changed: Any) -> dict[str, Any]:
    place = {"cluster": 1, "slot": 1, "p": 0.5, "pose": (0.0, 8.0, 0.0),
             "cov": (0.01, 0.0, 0.01, 0.01), "age": 1}  # fmt: skip
    return {"step": 1, "places": [place], "scan": [], "truth": None, **changed}


def pixel(image: Any, x_m: float, y_m: float) -> tuple[int, int, int]:
    """Of a picture of `room()`, not turned: 1,400 pixels are 20 m."""
    found: tuple[int, int, int] = image.getpixel(
        (round(MARGIN + (x_m + 4.0) * 70), round(MARGIN + (12.0 - y_m) * 70))
    )
    return found


def test_a_rotated_map_is_drawn_rotated() -> None:
    image = drawn_picture(
        room(turned=np.pi / 2), step(places=[])
    )  # now 10 m wide, and to the left of x = -4
    assert image.size == (748, 1448)
    right_low, right_high = (700, 1400), (700, 48)
    assert image.getpixel(right_low) == WHITE
    assert image.getpixel(right_high) == DARK  # what was right is up, what was low is right


def test_a_cluster_is_drawn_in_its_colour_where_it_is() -> None:
    image = drawn_picture(room(), step())
    assert "#{:02X}{:02X}{:02X}".format(*pixel(image, 0.0, 8.0)) == PALETTE[1]


def test_the_scan_is_drawn_from_the_best_place() -> None:
    image = drawn_picture(room(), step(scan=[300, 100]))
    red, green, _ = pixel(image, 3.0, 9.0)
    assert red > green + 80


@pytest.mark.parametrize("width_m", [20.0, 1.0])
def test_a_title_comes_with_a_scale_bar_and_a_legend(width_m: float) -> None:
    """Of 2 m for a room, and also above a narrow corridor."""
    cells = np.zeros((40, round(width_m / CELL_M)), np.int8)
    image = drawn_picture(GridMap(cells, CELL_M, (0.0, 0.0, 0.0)), step(), "robot " * 40)
    below = np.asarray(image)[-60:]
    dark = (np.asarray(image)[33:73, image.width // 2 :] < 60).all(axis=2)
    assert dark.sum(axis=1).max() == pytest.approx(2 * 70, abs=3)
    assert (below == (192, 38, 45)).all(axis=2).any(), "the scan's colour"


FLAT = {**step()["places"][0], "cov": (0.0, 0.0, 0.0, 0.0)}


@pytest.mark.parametrize("places", [[], [{**FLAT, "p": 1.0}], [{**FLAT, "p": 1e-9}]])
def test_no_place_or_one_of_any_probability_can_be_drawn(places: list[dict[str, Any]]) -> None:
    assert drawn_picture(room(), step(places=places)).size == (1448, 748)


@pytest.mark.parametrize(
    ("probability", "written"),
    [(1.0, "100 %"), (0.994, "99 %"), (0.0312, "3.1 %"), (0.004, "0.4 %"), (2e-5, "< 0.1 %")],
)
def test_a_small_probability_is_not_written_as_zero(probability: float, written: str) -> None:
    assert percent(probability) == written


def test_the_true_pose_is_a_ring() -> None:
    image = drawn_picture(room(), step(truth=(2.0, 5.0, 0.0)))
    assert pixel(image, 2.0, 5.0) == WHITE
    assert max(pixel(image, 2.0 - 18 / 70, 5.0)) < 120
