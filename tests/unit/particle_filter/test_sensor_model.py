from typing import get_args

import numpy as np
import pytest

from particle_filter.beam_model import BeamModel
from particle_filter.likelihood_field_model import LikelihoodFieldModel
from particle_filter.sensor_model import Beams, Grid, LaserScan, SensorModel
from particle_filter.sensor_models import computed_model, model_class
from particle_filter.settings import SensorModelName, SensorSettings
from tests.unit.particle_filter.rooms import (
    CELL_M,
    NO_OFFSET,
    beam_model_of,
    model_of,
    plain_room,
    seen_from,
)

FEW = SensorSettings(max_range_m=10.0, max_beams=4)
BEAM, FIELD = beam_model_of(plain_room(), FEW), model_of(plain_room(), FEW)
NO_RETURN, BROKEN = np.inf, np.nan
NAMES = get_args(SensorModelName)
every_model = pytest.mark.parametrize("name", NAMES)


def beams_of(ranges: list[float], model: SensorModel) -> Beams:
    return model.beams(LaserScan(np.array(ranges), 30.0, -1.0, 0.1, np.zeros(3)))


def test_a_beam_without_return_counts_for_the_beam_model_only() -> None:
    ranges = [1.0, NO_RETURN, BROKEN, 40.0, -2.0, 3.0]
    assert list(beams_of(ranges, BEAM).ranges) == [1.0, 10.0, 10.0, 3.0]
    assert list(beams_of(ranges, FIELD).ranges) == [1.0, 3.0]


def test_each_beam_keeps_its_direction_when_others_are_dropped() -> None:
    beams = beams_of([1.0, BROKEN, 2.0], FIELD)
    np.testing.assert_allclose(beams.angles, [-1.0, -0.8])


@every_model
def test_the_true_pose_fits_better_than_others(name: SensorModelName) -> None:
    room, truth = plain_room(), np.array([1.0, 3.0, 0.3])
    sensor = computed_model(Grid(room, CELL_M, NO_OFFSET), SensorSettings(model=name))
    others = truth + np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    fits = sensor.log_likelihood(np.vstack([truth, others]), seen_from(truth, room))
    assert np.argmax(fits) == 0
    assert fits[0] - fits[1:].max() > 10.0


def test_each_name_has_a_class_of_its_own() -> None:
    assert model_class("likelihood_field") is LikelihoodFieldModel
    assert model_class("beam") is BeamModel
    assert len({model_class(name) for name in NAMES}) == len(NAMES)


def test_a_name_that_no_model_has_is_no_other_model() -> None:
    with pytest.raises(AssertionError, match="third"):
        model_class("third")  # type: ignore[arg-type] # which the settings refuse


def test_what_is_taken_back_is_a_share_of_what_was_given_for_beams_through_walls() -> None:
    """The beam model followed every ray, and has given nothing for such a beam."""
    room, here = plain_room(), np.array([[1.0, 3.0, 0.3]])
    divided = plain_room()
    divided[:, 60] = 1
    given = SensorSettings(scan_likelihood_exponent=0.5, hidden_weight=0.2)
    beams, field = seen_from(here[0], room), model_of(divided, given)
    hidden = field.mean_hidden(here, np.ones(1), beams)
    assert hidden > 10.0
    assert field.correction(here, np.ones(1), beams) == pytest.approx(0.1 * hidden)
    assert beam_model_of(divided, given).correction(here, np.ones(1), beams) == 0.0


@every_model
def test_a_map_without_obstacles_is_refused(name: SensorModelName) -> None:
    with pytest.raises(ValueError, match="no occupied cell"):
        computed_model(Grid(np.zeros((3, 3), np.int8), 0.1, NO_OFFSET), SensorSettings(model=name))


@every_model
def test_arrays_of_another_map_are_refused(name: SensorModelName) -> None:
    kind, settings = model_class(name), SensorSettings(model=name)
    arrays = kind.arrays_of(Grid(plain_room(), CELL_M, NO_OFFSET), settings)
    other = Grid(plain_room()[1:], CELL_M, NO_OFFSET)
    with pytest.raises(ValueError, match="expected"):
        kind.from_arrays(other, arrays, settings)
