import math
from itertools import islice

import numpy as np
import pytest
from msgspec.structs import replace

from clustermcl import ClusterMCL, Reading
from clustermcl.filter.poses import compose
from clustermcl.protocol.steps import Landmark
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.system.conftest import SMALL
from tests.unit.clustermcl.tags import SIGMA_M, is_right, sight

OFFICE = world("office")
TICKS_MOVED, TICKS_BACK = 150, 250
BROKEN = "broken_source eye exit"


def drive(seed: int, moved_m: float) -> tuple[list[bool], list[float], list[int]]:
    simulation, rng = Simulation(OFFICE, seed), np.random.default_rng(seed)
    x, y, _ = compose(np.array(simulation.map_from_robot), np.array([1.5, 0.4, 0.0])).tolist()
    tag = Landmark(name="exit", x=x, y=y, sigma=0.05)
    mcl = ClusterMCL(OFFICE.map, landmarks=[tag], settings=SMALL, seed=seed)
    mcl.set_pose(simulation.map_from_robot)
    rights, news, left_out = [], [], []
    for number, tick in enumerate(islice(simulation, TICKS_MOVED + TICKS_BACK)):
        there = replace(tag, x=tag.x + moved_m * (number < TICKS_MOVED))
        seen = sight(tick, rng, tags=(there,), within_m=8.0)
        if seen is not None:
            covariance = np.eye(2) * SIGMA_M**2
            mcl.observe(
                seen[1], covariance, landmark="exit", stamp_ns=tick.laser.stamp_ns, source="eye"
            )
        for reading in (tick.odometry[0], tick.laser, tick.odometry[1]):
            before = mcl.dropped[BROKEN]
            if belief := mcl.update(Reading.of(reading)):
                rights.append(is_right(belief, tick))
                news.append(math.fsum(each.share for each in belief.scan.observations))
                left_out.append(mcl.dropped[BROKEN] - before)
    return rights, news, left_out


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
