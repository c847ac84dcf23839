import math

import pytest

from clustermcl.belief.search_pool import SearchPool
from clustermcl.filter.settings import FilterSettings, SearchSettings
from tests.unit.coordinator.reports import pool_of

SETTINGS = FilterSettings(search=SearchSettings(shards=1, converged_mass=0.8, max_steps=10))


def progress(share: float, left_out: float, step: int) -> float:
    search = SearchPool(("s0.0",), 1)
    pool = pool_of((share, (0.0, 5.0, 0.0)), step=step, left_out_gap=-math.log(left_out))
    finished = search.finished(pool, SETTINGS, patient=True)
    assert finished == (search.progress == 1.0)
    return search.progress


def test_search_progress_is_the_weight_of_its_places_over_the_required_weight() -> None:
    assert progress(0.4, 1e-9, 1) == pytest.approx(0.5)
    assert progress(0.9, 1e-9, 1) == 1.0


def test_weight_of_omitted_places_is_not_progress() -> None:
    assert progress(0.9, 0.6, 1) == pytest.approx(0.5)


def test_search_progress_is_at_least_the_share_of_the_elapsed_time() -> None:
    assert progress(0.0, 0.99, 7) == pytest.approx(0.7)
    assert progress(0.0, 0.99, 10) == 1.0
