import numpy as np

from particle_filter.sensor_model import LaserScan
from tests.unit.particle_filter.rooms import NO_OFFSET, beam_model_of, plain_room


def test_a_laser_that_sees_half_a_metre_is_scored() -> None:
    model = beam_model_of(plain_room())
    beams = model.beams(LaserScan(np.array([0.3, 0.9]), 0.5, 0.0, 1.0, NO_OFFSET))
    assert np.isfinite(model.log_likelihood(np.array([[1.0, 3.0, 0.3]]), beams)).all()
