import pytest

from clustermcl.filter.laser.sensor_model import SensorModel
from tests.unit.coordinator.living import symmetric_room


@pytest.fixture(scope="session")
def model() -> SensorModel:
    return symmetric_room()
