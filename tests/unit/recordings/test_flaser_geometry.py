import math

import pytest

from clustermcl.recordings.carmen_log import flaser_angles


@pytest.mark.parametrize(
    ("beams", "first_deg", "last_deg"),
    [
        (180, -90.0, 89.0),
        (181, -90.0, 90.0),
        (360, -90.0, 89.5),
        (361, -90.0, 90.0),
        (401, -50.0, 50.0),
        (541, -135.0, 135.0),
        (721, -90.0, 90.0),
        (761, -95.0, 95.0),
        (1081, -135.0, 135.0),
        (682, -90.0, 90.0 - 180.0 / 682),
    ],
)
def test_the_number_of_beams_gives_their_directions(
    beams: int, first_deg: float, last_deg: float
) -> None:
    first, step = flaser_angles(beams)
    assert math.degrees(first) == pytest.approx(first_deg)
    assert math.degrees(first + step * (beams - 1)) == pytest.approx(last_deg)


def test_the_resolution_parameter_applies_only_to_lasers_that_are_not_sicks() -> None:
    first, step = flaser_angles(683, step_deg=240.0 / 682)
    assert math.degrees(first) == pytest.approx(-120.0)
    assert math.degrees(first + step * 682) == pytest.approx(120.0)
    assert flaser_angles(181, step_deg=0.5) == flaser_angles(181)
    assert flaser_angles(683, step_deg=-1.0) == flaser_angles(683)


def test_one_beam_looks_to_the_right_of_a_field_of_180_degrees() -> None:
    first, step = flaser_angles(1)
    assert (first, step) == (-math.pi / 2, math.pi)
