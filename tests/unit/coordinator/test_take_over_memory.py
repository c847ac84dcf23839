"""The workers' states at a take-over are megabytes, and needed for a moment only."""

import gc

import pytest

from coordinator.events import WorkerSnapshot
from particle_filter.sensor_model import SensorModel
from tests.unit.coordinator.living import Living, symmetric_room


@pytest.fixture(scope="module")
def model() -> SensorModel:
    return symmetric_room()


def test_a_coordinator_drops_the_workers_answers_after_a_take_over(model: SensorModel) -> None:
    living = Living(model)
    for step in range(12):
        living.drive(step)
    living.revive()
    living.drive(12)
    assert [belief.state for belief in living.beliefs[12]] != ["searching"]
    gc.collect()
    held = [told for told in gc.get_objects() if isinstance(told, WorkerSnapshot)]
    assert held == []
