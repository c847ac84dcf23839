from itertools import islice

import numpy as np
import pytest

from clustermcl import ClusterMCL, Reading
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.system.conftest import SMALL
from tests.unit.clustermcl.tags import is_right

pytestmark = pytest.mark.filterwarnings("ignore:(too many|broken) source")

OFFICE = world("office")
FROM, FLOOD = 40, 60
"""First tick of the false poses, and number of ticks of a flood of names, 6 s."""


@pytest.mark.parametrize(
    ("names", "correlation_s"), [(40, 30.0), (3_000, 30.0), (1, 1e-3)], ids=str
)
def test_false_poses_do_not_outvote_the_laser(names: int, correlation_s: float) -> None:
    """All report the same pose 4 m off, exact to 0.1 m, and claim to be never wrong."""
    simulation = Simulation(OFFICE, 0)
    mcl = ClusterMCL(OFFICE.map, settings=SMALL, seed=0)
    mcl.set_pose(simulation.map_from_robot)
    rights = []
    for number, tick in enumerate(islice(simulation, 110)):
        x, y, heading = tick.map_from_robot
        by_tick = names // FLOOD if names > FLOOD else names
        first = by_tick * (number - FROM) if names > FLOOD else 0
        for name in range(first, first + by_tick if 0 <= number - FROM < FLOOD else 0):
            mcl.observe(
                (x + 4.0, y, heading),
                0.01 * np.eye(3),
                stamp_ns=tick.laser.stamp_ns,
                source=f"name {name}",
                outlier_probability=1e-6,
                correlation_s=correlation_s,
            )
        beliefs = filter(None, (mcl.update(Reading.of(reading)) for reading in tick.readings))
        rights.extend(is_right(belief, tick) for belief in beliefs)
    assert all(rights)
