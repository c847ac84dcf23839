import numpy as np
import pytest

from clustermcl.filter.laser import pyramid
from clustermcl.filter.laser.likelihood_field_model import LikelihoodFieldModel
from clustermcl.filter.search import branch_and_bound, global_search, places
from clustermcl.filter.search.global_search import GlobalSearch
from clustermcl.filter.settings import FilterSettings, SearchSettings
from clustermcl.filter.slices import CALL_WORK, SLICE_WORK, WorkMeter, finished
from tests.unit.filter.rooms import model_of, plain_room, seen_from

START = np.array([1.0, 3.2, -0.4])


def many_rooms() -> np.ndarray:
    """Rooms that are just alike: nothing can be left out."""
    return np.tile(plain_room(), (6, 6))


class Counted:
    """Look-ups and other work since the last slice ended; the most of one."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.done = self.most = self.slices = 0
        level_sums, fits = pyramid.sum_steps, LikelihoodFieldModel.log_likelihood
        clustered = places.cluster_by_source_point

        def sums(level, offsets, runs):  # type: ignore[no-untyped-def] # stands in for a kernel
            self.done += int(runs[:, 2].sum()) * len(offsets) // branch_and_bound._SUMS_PER_LOOKUP
            return level_sums(level, offsets, runs)

        def log_likelihood(model, poses, beams):  # type: ignore[no-untyped-def] # as above
            self.done += len(poses) * beams.count
            return fits(model, poses, beams)

        def cluster(poses, *others):  # type: ignore[no-untyped-def] # as above
            self.done += 27 * len(poses)
            return clustered(poses, *others)

        monkeypatch.setattr(branch_and_bound, "sum_steps", sums)
        monkeypatch.setattr(LikelihoodFieldModel, "log_likelihood", log_likelihood)
        monkeypatch.setattr(places, "cluster_by_source_point", cluster)

    def slice_ends(self) -> None:
        self.most, self.done, self.slices = max(self.most, self.done), 0, self.slices + 1


def test_no_slice_of_a_search_does_more_than_its_share(monkeypatch: pytest.MonkeyPatch) -> None:
    cells, rng = many_rooms(), np.random.default_rng(0)
    model, settings = model_of(cells), FilterSettings(search=SearchSettings(shards=1))
    search, counted, before = GlobalSearch(model, settings, shard=0), Counted(monkeypatch), None
    whole = 0
    for step in range(4):
        pose = START + step * np.array([0.15, -0.05, 0.05])
        slices = search.advance(before, pose, seen_from(pose, cells), rng)
        before = pose
        for _ in slices:
            whole += counted.done
            counted.slice_ends()
        counted.slice_ends()
    # One part too many is begun before the meter is looked at.
    assert counted.most <= 1.5 * SLICE_WORK
    assert whole > 50 * SLICE_WORK  # else it shows nothing
    assert counted.slices < 10 * whole / SLICE_WORK  # a slice takes longer than its overhead


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


def test_a_meter_ends_a_slice_when_it_is_full() -> None:
    meter = WorkMeter()
    ends = [len(list(meter.spend(SLICE_WORK // 2 - CALL_WORK))) for _ in range(6)]
    assert ends == [0, 1, 0, 1, 0, 1]


def test_finished_returns_the_result_of_all_slices() -> None:
    def three():  # type: ignore[no-untyped-def] # a generator of the test's own
        yield
        yield
        return 3

    assert finished(three()) == 3
