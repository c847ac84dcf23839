"""The paper's letter as an algorithm: Cluster-MCL without what was added to it."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from coordinator.belief.outcome import Outcome
from evaluation import in_process, paper_letter
from evaluation.experiments.case import BASELINES, Case, SimulatedRobot
from evaluation.experiments.task import Run, Task
from particle_filter.sensor_model import SensorModel
from particle_filter.settings import FilterSettings
from process_runtime.settings import Settings
from protocol.steps import Scan


def test_every_experiment_has_a_row_for_it() -> None:
    assert "paper-letter" in BASELINES


def test_only_departures_from_the_paper_are_changed() -> None:
    plain = FilterSettings()
    letter = paper_letter.to_the_letter(plain)
    assert (letter.motion, letter.search, letter.seed) == (plain.motion, plain.search, plain.seed)
    assert letter.belief.squared_prior
    assert letter.belief.transition_probability == 0.0
    assert letter.belief.max_clusters == paper_letter.CLUSTERS
    assert letter.belief.kidnapping_probability == 0.0
    assert letter.cluster.resample_below_ess == 1.0


def test_its_scans_are_weighed_without_exponent_and_visibility(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[tuple[SensorModel, FilterSettings]] = []

    def watched(
        _scans: Iterator[Scan], model: SensorModel, settings: FilterSettings
    ) -> Iterator[tuple[Scan, Outcome]]:
        told.append((model, settings))
        yield from ()

    monkeypatch.setattr(in_process, "outcomes", watched)
    case = Case(name="t", title="t", robot=SimulatedRobot(world="rectangle"), seeds=1, updates=2)
    task = Task(
        case=case, algorithm="paper-letter", seed=0, settings=Settings(), cache_folder=tmp_path
    )
    assert list(Run(task).outcomes()) == []
    ((model, settings),) = told
    assert model.settings == settings.sensor
    assert settings.sensor.scan_likelihood_exponent == 1.0
    assert settings.sensor.visibility_particles == 0
