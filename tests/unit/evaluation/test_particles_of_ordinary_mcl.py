"""The baseline has as much to work with as what it is compared with."""

import numpy as np
import pytest

from evaluation import ordinary_mcl
from particle_filter import global_search
from particle_filter.sensor_model import Grid
from particle_filter.sensor_models import computed_model
from particle_filter.settings import ClusterSettings, FilterSettings, SearchSettings
from tests.unit.oracle.tiny_world import CELL_M, SENSOR, TRUTH, Drive, plain_room


def test_it_starts_with_a_searchs_particles_and_keeps_as_many_as_ten_clusters_together(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settings = FilterSettings(
        sensor=SENSOR,
        cluster=ClusterSettings(particles=300),
        search=SearchSettings(
            min_start_particles=9_000, max_start_particles=9_000, annealing_steps=3, shards=4
        ),
    )
    counts = []
    advance = global_search.GlobalSearch.advance

    def counted(search: global_search.GlobalSearch, *arguments: object) -> object:
        result = advance(search, *arguments)  # type: ignore[arg-type] # passed on as they are
        counts.append(len(search.cloud.log_weights))
        return result

    monkeypatch.setattr(global_search.GlobalSearch, "advance", counted)
    model = computed_model(Grid(plain_room(), CELL_M, np.zeros(3)), SENSOR)
    scans = Drive(plain_room(), TRUTH, 6, first_step=0).scans
    outcomes = list(ordinary_mcl.outcomes(scans, model, settings))
    assert counts[0] == 9_000
    assert counts[-1] == 10 * 300
    assert len(outcomes) == 6
