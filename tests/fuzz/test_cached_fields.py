from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.filter.settings import SensorSettings
from clustermcl.jobs.map_model import sensor_model
from clustermcl.recordings.maps.grid_map import GridMap
from tests.fuzz.effort import cases
from tests.fuzz.mutations import damaged

SETTINGS = SensorSettings()


def walled() -> GridMap:
    cells = np.zeros((12, 15), np.int8)
    cells[[0, -1], :] = 1
    return GridMap(cells, 0.1, (0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def computed() -> SensorModel:
    return sensor_model(walled(), SETTINGS, None)


@cases(0.02)
@given(st.integers(0, 3), st.data())
def test_a_damaged_cache_is_computed_again(
    folder: Path, computed: SensorModel, which: int, data: st.DataObject
) -> None:
    sensor_model(walled(), SETTINGS, folder)
    (entry,) = folder.glob("field-*[!t]")
    file = sorted(entry.iterdir())[which]
    file.write_bytes(data.draw(damaged(st.just(file.read_bytes()))))
    model = sensor_model(walled(), SETTINGS, folder)
    np.testing.assert_array_equal(model.jumps, computed.jumps)
    np.testing.assert_array_equal(model.field.codes, computed.field.codes)
    assert model.field.log_step == computed.field.log_step
