from collections.abc import Iterator
from math import hypot
from pathlib import Path

import pytest

from clustermcl.filter.settings import BeliefSettings
from clustermcl.jobs.in_process import outcomes
from clustermcl.jobs.map_model import sensor_model
from clustermcl.protocol.answers import Hypothesis
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan
from clustermcl.runtime.settings import BridgeSettings, Settings
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.source import simulated_steps
from tests.soak.eight_rooms import PLACES, copies_in_all_rooms, eight_rooms

SETTINGS = Settings(
    belief=BeliefSettings(max_clusters=PLACES),
    bridge=BridgeSettings(gate_distance_m=0.0, gate_turn_rad=0.0),
)
"""Every scan is a step, so a step has little evidence."""
FOUND_WITHIN = 40


@pytest.mark.parametrize(("seed", "lifted_at"), [(0, 150), (11, 337)])
def test_a_kidnapped_robot_is_tracked_in_all_eight_rooms(
    seed: int, lifted_at: int, tmp_path: Path
) -> None:
    """Kidnapped in the middle of a periodic search (11), and at once after one (0)."""
    world = eight_rooms()
    simulation = Simulation(world, seed)
    steps = lifted_at + FOUND_WITHIN
    truths: list[PoseTuple] = []

    def scans() -> Iterator[Scan]:
        for scan, map_from_robot in simulated_steps(simulation, SETTINGS.bridge, steps=steps):
            truths.append(map_from_robot)
            if scan.step == lifted_at:
                simulation.kidnap()
            yield scan

    model = sensor_model(world.map, SETTINGS.sensor, tmp_path)
    for _, outcome in outcomes(scans(), model, SETTINGS):
        sure = max((place.probability for place in outcome.hypotheses), default=0.0)
        assert sure < 0.5, f"update {len(truths)}"
    rooms = copies_in_all_rooms(truths[-1])
    shares = [_probability_at(room, outcome.hypotheses) for room in rooms]
    assert min(shares) > 0.05, shares
    assert sum(shares) > 0.9, shares


def _probability_at(map_from_robot: PoseTuple, places: tuple[Hypothesis, ...]) -> float:
    x, y, _ = map_from_robot
    return sum(p.probability for p in places if hypot(p.pose[0] - x, p.pose[1] - y) < 0.5)
