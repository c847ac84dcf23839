import math
import weakref

import numpy as np
import pytest

from clustermcl.filter.grid import MOST_KEPT, Grid
from clustermcl.filter.laser.likelihood_field import scan_log_likelihood
from clustermcl.filter.search import branch_and_bound
from clustermcl.filter.search.branch_and_bound import (
    BranchAndBoundSearch,
    Circle,
    Leaves,
    SearchSpace,
    free_leaves,
)
from clustermcl.filter.settings import SearchSettings
from tests.unit.filter.rooms import model_of, plain_room, seen_from

HERE = np.array([1.0, 3.2, -0.4])
ROOM = model_of(plain_room())
STEP_RAD = 0.1


def space_of(shards: int = 1, near: Circle | None = None) -> SearchSpace:
    return SearchSpace(ROOM.grid, ROOM.pyramid.leaf_cells, STEP_RAD, shards, near)


def searched(
    rules: SearchSettings, shard: int = 0, seed: int = 0, near: Circle | None = None
) -> Leaves:
    hits = seen_from(HERE, plain_room()).hits_in_robot
    rng = np.random.default_rng(seed)
    grid = BranchAndBoundSearch(ROOM, space_of(rules.shards, near), hits, shard, rules, rng)
    for _ in grid.slices():
        pass
    return grid.leaves()


def brute_force(near: Circle | None = None) -> tuple[np.ndarray, np.ndarray]:
    """All leaves that hold free cells, and their scores by the field itself."""
    space, hits = space_of(near=near), seen_from(HERE, plain_room()).hits_in_robot
    leaves = np.flatnonzero(space.free[-1])
    poses = np.concatenate(
        [space.poses(leaves, np.full(len(leaves), h)) for h in range(len(space.headings))]
    )
    exponent = ROOM.settings.scan_likelihood_exponent
    return poses, exponent * scan_log_likelihood(poses, hits, ROOM.field)


@pytest.mark.parametrize("near", [None, (4.5, 1.0, 0.8)], ids=["everywhere", "not where it is"])
@pytest.mark.parametrize("bound_below", [0.0, math.inf], ids=["no bounds", "all bounds"])
def test_branch_and_bound_finds_all_leaves_within_the_margin_and_no_others(
    bound_below: float, near: Circle | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(branch_and_bound, "_BOUND_BELOW", bound_below)
    poses, scores = brute_force(near)
    margin = 6.0
    found = searched(SearchSettings(shards=1, poses=10_000_000, margin=margin), near=near)
    assert found.sampled == 0.0
    # Steps of eight bits are rounded up: 72 beams are 0.0215 nat too high at most, by 0.1.
    rounding = 72 * 0.0215 * 0.1
    sure = scores >= scores.max() - margin + rounding
    possible = scores >= scores.max() - margin - 2 * rounding
    as_rows = {tuple(pose) for pose in np.round(found.map_from_robot, 6).tolist()}
    assert {tuple(pose) for pose in np.round(poses[sure], 6).tolist()} <= as_rows
    assert as_rows <= {tuple(pose) for pose in np.round(poses[possible], 6).tolist()}
    assert found.scores.max() == pytest.approx(scores.max(), abs=rounding)


def test_the_weight_of_a_sample_is_that_of_all() -> None:
    _, scores = brute_force()
    rules = SearchSettings(shards=1, poses=400, margin=30.0)
    exact = float(np.logaddexp.reduce(scores)) - math.log(space_of().leaf_count)
    for seed in range(5):
        found = searched(rules, seed=seed)
        assert len(found.scores) == 400
        assert 0.0 < found.sampled < 1.0
        # Rounding up lifts every score by 0.08 on average.
        total = float(np.logaddexp.reduce(found.log_weights))
        assert total == pytest.approx(exact + 0.08, abs=0.08)


def test_the_shards_share_the_headings() -> None:
    rules = SearchSettings(shards=3, poses=10_000_000, margin=6.0)
    parts = [searched(rules, shard=shard).map_from_robot[:, 2] for shard in range(3)]
    headings = [set(np.round(part, 9).tolist()) for part in parts]
    assert all(headings)
    assert not headings[0] & headings[1]
    assert not headings[1] & headings[2]


def test_a_circle_limits_the_search_unless_it_has_no_free_leaf() -> None:
    model, everywhere = ROOM, space_of()
    near = SearchSpace(model.grid, model.pyramid.leaf_cells, STEP_RAD, 1, near=(1.0, 3.0, 0.7))
    leaves = np.flatnonzero(near.free[-1])
    poses = near.poses(leaves, np.zeros(len(leaves), np.int64))
    assert np.all(np.hypot(poses[:, 0] - 1.0, poses[:, 1] - 3.0) <= 0.7)
    # A circle of 1.5 m2 holds 38 leaves, give or take those at its rim.
    assert len(leaves) == pytest.approx(38, abs=6)
    share = len(leaves) / np.count_nonzero(everywhere.free[-1])
    assert near.leaf_count == pytest.approx(share * everywhere.leaf_count)
    nowhere = SearchSpace(model.grid, model.pyramid.leaf_cells, STEP_RAD, 1, near=(99.0, 0.0, 1.0))
    assert nowhere.leaf_count == everywhere.leaf_count


def test_a_rectangle_limits_the_search_unless_it_has_no_free_leaf() -> None:
    def leaves_in(*corners: tuple[float, float]) -> SearchSpace:
        return SearchSpace(ROOM.grid, ROOM.pyramid.leaf_cells, STEP_RAD, 1, corners=corners)

    part = leaves_in((0.5, 2.5), (1.5, 3.5))
    leaves = np.flatnonzero(part.free[-1])
    poses = part.poses(leaves, np.zeros(len(leaves), np.int64))
    assert np.all((poses[:, 0] >= 0.5) & (poses[:, 0] <= 1.5))
    assert np.all((poses[:, 1] >= 2.5) & (poses[:, 1] <= 3.5))
    assert len(leaves) == 25, "five a side, of which the first lie on the rectangle's low sides"
    assert leaves_in((90.0, 90.0), (91.0, 91.0)).leaf_count == space_of().leaf_count


def test_each_map_of_many_robots_keeps_its_leaves_until_it_ends() -> None:
    grids = [Grid(ROOM.grid.cells.copy(), 0.05, np.zeros(3)) for _ in range(6)]
    first = [free_leaves(grid, 4)[0] for grid in grids]
    assert all(free_leaves(grid, 4)[0] is free for grid, free in zip(grids, first, strict=True))
    ended = weakref.ref(grids[0])
    del grids[0]
    assert ended() is None


def test_a_map_keeps_the_last_results_only() -> None:
    grid = Grid(ROOM.grid.cells.copy(), 0.05, np.zeros(3))
    first = [free_leaves(grid, leaf)[0] for leaf in range(1, MOST_KEPT + 2)]
    assert free_leaves(grid, MOST_KEPT + 1)[0] is first[-1]
    assert free_leaves(grid, 1)[0] is not first[0]
