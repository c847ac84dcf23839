"""How near a search is to its end."""

import math

import pytest

from coordinator.belief.search_pool import SearchPool
from particle_filter.settings import SearchSettings
from tests.unit.coordinator.reports import pool_of

SETTINGS = SearchSettings(shards=1, converged_mass=0.8, max_steps=10)


def progress(share: float, left_out: float, step: int) -> float:
    search = SearchPool(0, 1, SETTINGS)
    pool = pool_of((share, (0.0, 5.0, 0.0)), step=step, left_out_gap=-math.log(left_out))
    finished = search.finished(pool, 64)
    assert finished == (search.progress == 1.0)
    return search.progress


def test_it_is_the_share_of_what_its_places_must_hold() -> None:
    assert progress(0.4, 1e-9, 1) == pytest.approx(0.5)
    assert progress(0.9, 1e-9, 1) == 1.0


def test_what_was_left_out_is_not_held() -> None:
    assert progress(0.9, 0.6, 1) == pytest.approx(0.5)


def test_it_ends_with_its_time() -> None:
    assert progress(0.0, 0.99, 7) == pytest.approx(0.7)
    assert progress(0.0, 0.99, 10) == 1.0
