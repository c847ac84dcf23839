"""Tags that a camera sees: true ones, false ones, and one that was moved."""

import math
from collections.abc import Iterator
from itertools import islice

import numpy as np
import pytest
from msgspec.structs import replace

from clustermcl import ClusterMCL
from clustermcl.filter.poses import compose
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Landmark
from clustermcl.simulator.simulation import Simulation, Tick
from tests.integration.system.conftest import SMALL
from tests.unit.clustermcl.tags import OFFICE, beliefs, driven, is_right, observe, sight

TICKS = 400
SEEDS = range(8)


def test_one_step_after_the_first_observation_the_robot_is_found() -> None:
    found: list[bool] = []
    for seed in SEEDS:
        seen = (each for each in beliefs(seed, SMALL, TICKS) if each[2])
        for belief, tick, _ in islice(seen, 1, 2):  # some robots stay in the arms without a tag
            found.append(belief.state == "localized" and is_right(belief, tick))
        if len(found) == 4:
            break
    assert found == [True] * 4


def test_without_an_observation_the_arms_stay_equally_probable() -> None:
    for seed in range(3):
        reported = [belief.state for belief, *_ in beliefs(seed, SMALL, TICKS // 2, observes=False)]
        assert "localized" not in reported


def test_with_a_tenth_of_false_landmark_names_the_robot_is_rarely_sure_and_wrong() -> None:
    steps = wrong = 0
    for seed in SEEDS[:4]:
        for belief, tick, _ in beliefs(seed, SMALL, TICKS, false=0.1):
            steps += 1
            wrong += belief.state == "localized" and not is_right(belief, tick)
    assert steps > 300
    assert wrong <= 0.005 * steps


def tag_ahead(map_from_robot: PoseTuple) -> Landmark:
    x, y, _ = compose(np.array(map_from_robot), np.array([1.5, 0.4, 0.0])).tolist()
    return Landmark(name="exit", x=x, y=y, sigma=0.05)


def first_after_kidnapping(seed: int, *, observes: bool = True) -> tuple[bool, bool]:
    """Return whether the most probable place is right before, and at the first step after."""
    simulation, rng = Simulation(OFFICE, seed), np.random.default_rng(seed)
    target = Simulation(OFFICE, 1000 + seed).kidnap()
    tag = tag_ahead(target)
    mcl = ClusterMCL(OFFICE.map, landmarks=[tag], settings=SMALL, seed=seed)
    mcl.set_pose(simulation.map_from_robot)

    def rights(ticks: int, tags: tuple[Landmark, ...]) -> Iterator[bool]:
        def look(tick: Tick) -> None:
            observe(mcl, tick, sight(tick, rng, tags=tags))

        return (is_right(*step) for step in driven(mcl, islice(simulation, ticks), look))

    *_, before = rights(100, ())
    simulation.kidnap(target)
    return before, next(rights(20, (tag,) if observes else ()))


@pytest.mark.filterwarnings("ignore:odometry contradicted")
def test_a_kidnapped_robot_is_localized_at_the_first_observation_and_later_without() -> None:
    """In one run, another pose in sight of the tag fits the first scan better."""
    before, after = zip(*map(first_after_kidnapping, range(4)), strict=True)
    assert all(before)
    assert sum(after) >= 3
    without = [first_after_kidnapping(seed, observes=False) for seed in range(3)]
    assert without == [(True, False)] * 3


TICKS_MOVED, TICKS_BACK = 150, 250
BROKEN = "broken_source eye exit"


def drive(seed: int, moved_m: float) -> tuple[list[bool], list[float], list[int]]:
    """Return of each step whether it is right, the news of the tag, and what was left out."""
    simulation, rng = Simulation(OFFICE, seed), np.random.default_rng(seed)
    tag = tag_ahead(simulation.map_from_robot)
    mcl = ClusterMCL(OFFICE.map, landmarks=[tag], settings=SMALL, seed=seed)
    mcl.set_pose(simulation.map_from_robot)
    rights, news, left_out = [], [], [0]

    def look(tick: Tick) -> None:
        is_moved = tick.laser.stamp_ns < TICKS_MOVED * 10**8
        there = replace(tag, x=tag.x + moved_m * is_moved)
        observe(mcl, tick, sight(tick, rng, tags=(there,), within_m=8.0), source="eye")

    for belief, tick in driven(mcl, islice(simulation, TICKS_MOVED + TICKS_BACK), look):
        rights.append(is_right(belief, tick))
        news.append(math.fsum(each.share for each in belief.scan.observations))
        left_out.append(mcl.dropped[BROKEN])
    return rights, news, np.diff(left_out).tolist()


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.filterwarnings("ignore:broken source")
def test_a_moved_tag_is_found_broken_and_the_belief_stays_right(seed: int) -> None:
    rights, news, left_out = drive(seed, 2.0)
    assert all(rights)
    first = np.flatnonzero(left_out)[0]
    assert 1.0 < math.fsum(news[:first]) < 4.0


@pytest.mark.filterwarnings("ignore:broken source")
def test_a_tag_that_was_moved_back_counts_again() -> None:
    """This robot sees the tag again after it was moved back."""
    _, news, left_out = drive(4, 2.0)
    last = np.flatnonzero(left_out)[-1]
    assert sum(left_out[:last]) > 20
    assert math.fsum(news[last:]) > 0.5  # later sights weigh less


def test_a_tag_that_was_not_moved_always_counts() -> None:
    rights, news, left_out = drive(0, 0.0)
    assert all(rights)
    assert math.fsum(news) > 2.5
    assert not any(left_out)
