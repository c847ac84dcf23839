"""The baseline gets the same number of particles as Cluster-MCL."""

import numpy as np
import pytest

from evaluation import ordinary_mcl
from evaluation.one_cloud import LEAST_START_PARTICLES, OneCloud
from particle_filter.sensor_model import Grid
from particle_filter.sensor_models import computed_model
from particle_filter.settings import BeliefSettings, ClusterSettings, FilterSettings
from tests.unit.oracle.tiny_world import CELL_M, SENSOR, TRUTH, Drive, plain_room


def test_it_starts_everywhere_and_keeps_as_many_as_all_clusters_together(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settings = FilterSettings(
        sensor=SENSOR,
        cluster=ClusterSettings(particles=300),
        belief=BeliefSettings(max_clusters=4, particles=0),
    )
    counts = []
    advance = OneCloud.advance

    def counted(search: OneCloud, *arguments: object) -> object:
        result = advance(search, *arguments)  # type: ignore[arg-type] # passed on as they are
        counts.append(len(search.particles.log_weights))
        return result

    monkeypatch.setattr(OneCloud, "advance", counted)
    model = computed_model(Grid(plain_room(), CELL_M, np.zeros(3)), SENSOR)
    scans = Drive(plain_room(), TRUTH, 8, first_step=0).scans
    outcomes = list(ordinary_mcl.outcomes(scans, model, settings))
    assert counts[0] == LEAST_START_PARTICLES
    assert counts[-1] == 4 * 300
    assert len(outcomes) == 8
