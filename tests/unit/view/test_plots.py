import math
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from clustermcl.protocol.answers import Hypothesis
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.view.plots import (
    PALETTE,
    Drawn,
    draw_map,
    draw_places,
    draw_run,
    new_figure,
    percent,
)
from tests.unit.evaluation.places import place

ROOM = np.zeros((20, 40), np.int8)
ROOM[:10, 20:] = 1  # the low right quarter is a wall


def drawn(heading: float, places: tuple[Hypothesis, ...] = (), **more: Any) -> Any:
    (axes,) = new_figure().axes
    draw_map(axes, GridMap(ROOM, 0.5, (-4.0, 2.0, heading)))
    draw_places(axes, places, **more)
    return axes


def test_a_map_is_drawn_in_metres_and_rotated() -> None:
    """A quarter turn: 10 m wide, and to the left of x = -4."""
    axes = drawn(math.pi / 2)
    assert axes.get_xlim() == pytest.approx((-14.0, -4.0))
    assert axes.get_ylim() == pytest.approx((2.0, 22.0))
    canvas = FigureCanvasAgg(axes.figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())
    for x, y, dark in ((-5.0, 3.0, False), (-5.0, 21.0, True), (-13.0, 21.0, False)):
        column, row = axes.transData.transform((x, y)).round().astype(int)
        assert (pixels[len(pixels) - row, column, 0] < 60) == dark


@pytest.mark.parametrize(("probability", "spread_m2"), [(1.0, 0.01), (1e-9, 0.0)])
def test_a_place_is_drawn_in_its_colour_with_its_probability(
    probability: float, spread_m2: float
) -> None:
    spread = (spread_m2, 0.0, 0.0, 0.0, spread_m2, 0.0, 0.0, 0.0, 0.01)
    at = place(probability, (1.0, 8.0, math.pi / 2), cluster=1, covariance=spread)
    axes = drawn(0.0, (at,), truth=(2.0, 5.0, 0.0))
    (marker,) = axes.collections
    assert marker.get_offsets().tolist() == [[1.0, 8.0]]
    assert tuple(marker.get_facecolor()[0][:3]) == pytest.approx(
        tuple(int(PALETTE[1][at : at + 2], 16) / 255 for at in (1, 3, 5))
    )
    assert [text.get_text() for text in axes.texts] == [percent(probability)]
    assert axes.lines[0].get_xydata()[0] == pytest.approx((2.0, 5.0)), "the true pose"


@pytest.mark.parametrize(
    ("probability", "written"),
    [(1.0, "100 %"), (0.994, "99 %"), (0.0312, "3.1 %"), (0.004, "0.4 %"), (2e-5, "< 0.1 %")],
)
def test_a_small_probability_is_not_written_as_zero(probability: float, written: str) -> None:
    assert percent(probability) == written


@pytest.mark.parametrize("errors_m", [[0.5, None, 0.1], [None] * 3])
def test_a_run_is_drawn_as_path_probability_and_error(errors_m: list[float | None]) -> None:
    poses = [(1.0, 3.0, 0.0), (2.0, 3.5, 0.1), (3.0, 4.0, 0.2)]
    steps = [
        Drawn(10**18 + i * 500_000_000, poses[i], (0.2, 0.6, 1.0)[i], errors_m[i]) for i in range(3)
    ]
    figure = new_figure((3.0, 1.0))
    draw_run(figure, GridMap(ROOM, 0.5, (-4.0, 2.0, 0.0)), steps)
    FigureCanvasAgg(figure).draw()
    above, below, _bar, *errors = figure.axes
    (path,) = above.collections
    assert path.get_offsets().tolist() == [[x, y] for x, y, _ in poses]
    assert path.get_array().tolist() == [0.2, 0.6, 1.0]
    assert below.lines[0].get_xydata().tolist() == [[0.0, 0.2], [0.5, 0.6], [1.0, 1.0]]
    drawn_m = [axes.lines[0].get_ydata().tolist() for axes in errors]
    assert drawn_m == ([errors_m] if any(errors_m) else [])
