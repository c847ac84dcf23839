import pytest

from particle_filter.sensor_model import SensorModel
from tests.unit.coordinator.living import symmetric_room


@pytest.fixture(scope="session")
def model() -> SensorModel:
    return symmetric_room()
