import numpy as np
import pytest

from particle_filter.sensor_model import beams_of
from particle_filter.settings import SensorSettings
from tests.unit.particle_filter.rooms import model_of, plain_room, seen_from

BEAM = SensorSettings(model="beam", max_range_m=10.0, max_beams=4)
FIELD = SensorSettings(max_range_m=10.0, max_beams=4)
NO_RETURN, BROKEN = np.inf, np.nan


def chosen(ranges: list[float], settings: SensorSettings) -> list[float]:
    beams = beams_of(np.array(ranges), 30.0, -1.0, 0.1, np.zeros(3), settings)
    return list(beams.ranges)


def test_a_beam_without_return_counts_for_the_beam_model_only() -> None:
    ranges = [1.0, NO_RETURN, BROKEN, 40.0, -2.0, 3.0]
    assert chosen(ranges, BEAM) == [1.0, 10.0, 10.0, 3.0]
    assert chosen(ranges, FIELD) == [1.0, 3.0]


def test_each_beam_keeps_its_direction_when_others_are_dropped() -> None:
    beams = beams_of(np.array([1.0, BROKEN, 2.0]), 30.0, -1.0, 0.1, np.zeros(3), FIELD)
    np.testing.assert_allclose(beams.angles, [-1.0, -0.8])


@pytest.mark.parametrize("model", ["likelihood_field", "beam"])
def test_the_true_pose_fits_better_than_others(model: str) -> None:
    settings = SensorSettings(
        model=model  # type: ignore[arg-type] # one of the two above
    )
    room, truth = plain_room(), np.array([1.0, 3.0, 0.3])
    sensor = model_of(room, settings)
    others = truth + np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    fits = sensor.log_likelihood(np.vstack([truth, others]), seen_from(truth, room))
    assert np.argmax(fits) == 0
    assert fits[0] - fits[1:].max() > 10.0
