"""Eight rooms exactly alike: the belief keeps all of them, or finds the missing ones again."""

from collections.abc import Iterator
from math import dist, hypot
from pathlib import Path

import pytest

from clustermcl.filter.settings import BeliefSettings, FilterSettings
from clustermcl.jobs.in_process import InProcess, outcomes
from clustermcl.jobs.map_model import sensor_model
from clustermcl.protocol.answers import Hypothesis
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.source import simulated_steps
from tests.soak.eight_rooms import PLACES, copies_in_all_rooms, eight_rooms

FOUND_WITHIN = 40
NAMED_AT, EVERY, STEPS = 5, 30, 70
WORLD = eight_rooms()


def near(places: tuple[Hypothesis, ...], pose: PoseTuple, within_m: float) -> list[Hypothesis]:
    return [place for place in places if dist(place.pose[:2], pose[:2]) < within_m]


@pytest.mark.parametrize(("seed", "lifted_at"), [(0, 150), (11, 337)])
def test_a_kidnapped_robot_is_tracked_in_all_eight_rooms(
    seed: int, lifted_at: int, tmp_path: Path
) -> None:
    """Kidnapped in the middle of a periodic search (11), and at once after one (0)."""
    simulation = Simulation(WORLD, seed)
    every_scan = BridgeSettings(gate_distance_m=0.0, gate_turn_rad=0.0)  # with little evidence
    truths: list[PoseTuple] = []

    def scans() -> Iterator[Scan]:
        steps = simulated_steps(simulation, every_scan, steps=lifted_at + FOUND_WITHIN)
        for scan, map_from_robot in steps:
            truths.append(map_from_robot)
            if scan.step == lifted_at:
                simulation.kidnap()
            yield scan

    settings = FilterSettings(belief=BeliefSettings(max_clusters=PLACES))
    for _, outcome in outcomes(
        scans(), sensor_model(WORLD.map, settings.sensor, tmp_path), settings
    ):
        sure = max((place.probability for place in outcome.hypotheses), default=0.0)
        assert sure < 0.5, f"update {len(truths)}"
    rooms = copies_in_all_rooms(truths[-1])
    shares = [sum(p.probability for p in near(outcome.hypotheses, room, 0.5)) for room in rooms]
    assert min(shares) > 0.05, shares
    assert sum(shares) > 0.9, shares


def test_later_searches_bring_back_the_missing_rooms(tmp_path: Path) -> None:
    """A belief that is sure of one room: the wrong one, as a person said."""
    settings = FilterSettings(belief=BeliefSettings(search_every_steps=EVERY))
    process = InProcess(sensor_model(WORLD.map, settings.sensor, tmp_path), settings)
    sure = 0
    for scan, truth in simulated_steps(Simulation(WORLD, 0), BridgeSettings(), steps=STEPS):
        outcome = process.advance(scan)
        rooms = copies_in_all_rooms(truth)
        if scan.step == NAMED_AT:
            x, y, _ = max(rooms, key=lambda room: hypot(room[0] - truth[0], room[1] - truth[1]))
            process.carry_out(process.ensemble.relocalize(scan.step, near=(x, y, 2.0)))
        held = sum(bool(near(outcome.hypotheses, room, 1.0)) for room in rooms)
        sure += held == 1 and outcome.state == "localized"
    assert sure > EVERY / 2, "of the one that was named"
    assert held == PLACES
    assert outcome.hypotheses[0].probability > 0.9, "a person said so"
