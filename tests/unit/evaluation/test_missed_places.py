"""A belief that is sure of one of eight rooms exactly alike: the wrong one, as a person said."""

from math import hypot
from pathlib import Path

from clustermcl.filter.settings import BeliefSettings, FilterSettings
from clustermcl.jobs.in_process import InProcess
from clustermcl.jobs.map_model import sensor_model
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.source import simulated_steps
from tests.soak.eight_rooms import PLACES, copies_in_all_rooms, eight_rooms

NAMED_AT, EVERY, STEPS = 5, 30, 70
SETTINGS = FilterSettings(belief=BeliefSettings(search_every_steps=EVERY))


def test_later_searches_bring_back_the_missing_rooms(tmp_path: Path) -> None:
    world = eight_rooms()
    model = sensor_model(world.map, SETTINGS.sensor, tmp_path)
    process = InProcess(model, SETTINGS)
    sure = 0
    for scan, truth in simulated_steps(Simulation(world, 0), BridgeSettings(), steps=STEPS):
        outcome = process.advance(scan)
        rooms = copies_in_all_rooms(truth)
        if scan.step == NAMED_AT:
            x, y, _ = max(rooms, key=lambda room: hypot(room[0] - truth[0], room[1] - truth[1]))
            process.carry_out(process.ensemble.relocalize(scan.step, near=(x, y, 2.0)))
        held = [
            any(hypot(h.pose[0] - x, h.pose[1] - y) < 1.0 for h in outcome.hypotheses)
            for x, y, _ in rooms
        ]
        sure += held.count(True) == 1 and outcome.state == "localized"
    assert sure > EVERY / 2, "of the one that was named"
    assert held.count(True) == PLACES, held
    assert outcome.hypotheses[0].probability > 0.9, "a person said so"
