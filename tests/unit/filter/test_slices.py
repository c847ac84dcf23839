from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.filter.search import branch_and_bound, global_search, places
from clustermcl.filter.search.global_search import GlobalSearch
from clustermcl.filter.settings import FilterSettings, SearchSettings
from clustermcl.filter.slices import SLICE_WORK, finished
from tests.unit.filter.rooms import model_of, plain_room, seen_from

START = np.array([1.0, 3.2, -0.4])


def many_rooms() -> np.ndarray:
    """Rooms that are just alike: nothing can be left out."""
    return np.tile(plain_room(), (6, 6))


class Counted:
    """Look-ups since the last slice ended; the most of one, and all."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.done = self.most = self.whole = self.slices = 0

        def count(owner: Any, name: str, work: Callable[..., int]) -> None:
            counted = getattr(owner, name)

            def counting(*arguments: Any) -> Any:
                self.done += work(*arguments)
                return counted(*arguments)

            monkeypatch.setattr(owner, name, counting)

        per_lookup = branch_and_bound._SUMS_PER_LOOKUP
        count(branch_and_bound, "sum_steps", lambda _, of, r: r[:, 2].sum() * len(of) // per_lookup)
        count(SensorModel, "log_likelihood", lambda _, p, beams: len(p) * beams.count)
        count(places, "cluster_by_source_point", lambda poses, *_: 27 * len(poses))

    def slice_ends(self) -> None:
        self.most, self.whole = max(self.most, self.done), self.whole + self.done
        self.done, self.slices = 0, self.slices + 1


def test_no_slice_of_a_search_does_more_than_its_share(monkeypatch: pytest.MonkeyPatch) -> None:
    cells, rng = many_rooms(), np.random.default_rng(0)
    model, settings = model_of(cells), FilterSettings(search=SearchSettings(shards=1))
    search, counted, before = GlobalSearch(model, settings, shard=0), Counted(monkeypatch), None
    for step in range(4):
        pose = START + step * np.array([0.15, -0.05, 0.05])
        slices = search.advance(before, pose, seen_from(pose, cells), rng)
        before = pose
        for _ in slices:
            counted.slice_ends()
        counted.slice_ends()
    # One part too many is begun before the meter is looked at.
    assert counted.most <= 1.5 * SLICE_WORK
    assert counted.whole > 50 * SLICE_WORK  # else it shows nothing
    assert (
        counted.slices < 10 * counted.whole / SLICE_WORK
    )  # a slice takes longer than its overhead


def test_the_ends_of_slices_do_not_change_the_result(monkeypatch: pytest.MonkeyPatch) -> None:
    cells = plain_room()

    def found() -> np.ndarray:
        rng = np.random.default_rng(0)
        search = GlobalSearch(model_of(cells), FilterSettings(), shard=0)
        finished(search.advance(None, START, seen_from(START, cells), rng))
        finished(search.advance(START, START, seen_from(START, cells), rng))
        return np.concatenate([place.sample for place in finished(search.places(rng))])

    long = found()
    for module in (global_search, branch_and_bound):
        monkeypatch.setattr(module, "SLICE_WORK", 2**15)
    np.testing.assert_array_equal(found(), long)
