"""People walk on free ground, and occlude what is behind them."""

from itertools import islice

import numpy as np

from benchmarks.people import CrowdSimulation
from clustermcl.simulator.worlds.catalogue import world


def test_people_change_what_is_seen_but_not_where_the_robot_drives() -> None:
    alone, watched = (
        list(islice(CrowdSimulation(world("hall"), 3, people), 300)) for people in (0, 4)
    )
    assert [tick.map_from_robot for tick in alone] == [tick.map_from_robot for tick in watched]
    far, near = (
        np.array([tick.laser.ranges.array() for tick in ticks]) for ticks in (alone, watched)
    )
    shorter = near < far - 0.5
    assert 0.005 < np.mean(shorter) < 0.3
