"""The belief of a calm soak without its processes: rooms exactly alike, as many as clusters."""

from collections.abc import Iterator

import pytest

from evaluation.in_process import outcomes
from evaluation.pose_error import pose_error
from process_runtime.settings import BridgeSettings
from process_runtime.settings_file import load_settings
from protocol.message import PoseTuple
from protocol.steps import Scan
from robot_simulator.simulation import Simulation
from robot_simulator.source import SimulatedSource, simulated_steps
from tests.soak.eight_rooms import copies_in_all_rooms, eight_rooms
from worker.map_model import sensor_model

SEED, STEPS = 2, 390
"""A search that ends at step 383 finds three wrong places, turned by half a turn."""


@pytest.mark.timeout(300)  # it computes for 20 s, and may have to share its core
def test_a_search_displaces_no_true_room() -> None:
    world = eight_rooms()
    often = "belief.search_every_steps=25"
    settings = load_settings(None, ["belief.max_clusters=8", often, f"seed={SEED}"])
    every_scan = BridgeSettings(gate_distance_m=0.0, gate_turn_rad=0.0)
    source = SimulatedSource(Simulation(world, SEED), steps=STEPS)
    steps = simulated_steps(source, every_scan, world.map.digest)
    truths: dict[int, PoseTuple] = {}

    def scans() -> Iterator[Scan]:
        for scan, truth in steps:
            truths[scan.step] = truth
            yield scan

    model = sensor_model(world.map, settings.sensor, cache_folder=None)
    searches = 0
    for scan, outcome in outcomes(scans(), model, settings):
        searches += any(event.is_search for event in outcome.events)
        if not searches:
            continue
        copies = copies_in_all_rooms(truths[scan.step])
        for room, copy in enumerate(copies):
            held = any(pose_error(place.pose, copy).right for place in outcome.hypotheses)
            assert held, f"room {room} is lost at step {scan.step}: {outcome.events}"
    assert searches > 5
