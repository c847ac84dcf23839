import pytest

from benchmarks.experiments.baselines import SquaredPrior
from evaluation.in_process import InProcess
from particle_filter.settings import FilterSettings, SensorSettings
from tests.unit.coordinator.belief.test_ensemble import NORTH, SOUTH, bootstrapped, probabilities
from tests.unit.coordinator.reports import tracked
from tests.unit.particle_filter.rooms import model_of, plain_room
from tests.unit.worker.test_job_table import scan


def test_the_papers_letter_squares_the_prior(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without evidence, odds of 3 to 2 become 9 to 4, as eq. 17 has it."""
    process = SquaredPrior(model_of(plain_room(), SensorSettings()), FilterSettings())
    process.ensemble = bootstrapped({NORTH: 0.6, SOUTH: 0.4})
    alike = [tracked("c0", 1, 0.1, NORTH), tracked("c1", 1, 0.1, SOUTH)]
    monkeypatch.setattr(InProcess, "_reports", lambda *_: alike)
    outcome = process.ensemble.advance(1, process._reports(scan(1)))
    assert probabilities(outcome) == pytest.approx({0: 9.0 / 13.0, 1: 4.0 / 13.0})
