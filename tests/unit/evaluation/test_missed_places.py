"""A belief that is sure of one of eight rooms exactly alike: the wrong one, as a person said."""

from math import hypot
from pathlib import Path

import pytest
from msgspec.structs import replace

from coordinator.belief.ensemble import Ensemble
from coordinator.belief.outcome import Outcome
from particle_filter.settings import BeliefSettings, FilterSettings
from process_runtime.settings import BridgeSettings
from protocol.work import Assignment, Job
from robot_simulator.simulation import Simulation
from robot_simulator.source import SimulatedSource, simulated_steps
from soak_test.rooms import PLACES, copies_in_all_rooms, eight_rooms
from worker.jobs import RunningJob, running
from worker.map_model import sensor_model

NAMED_AT, EVERY, STEPS = 5, 30, 70
SETTINGS = FilterSettings(belief=BeliefSettings(search_every_steps=EVERY))


@pytest.mark.parametrize("seed", range(3))
def test_the_next_searches_bring_back_the_rooms_that_nobody_named(
    seed: int, tmp_path: Path
) -> None:
    world = eight_rooms()
    source = SimulatedSource(Simulation(world, seed), steps=STEPS)
    model = sensor_model(world.map, SETTINGS.sensor, tmp_path)
    settings = replace(SETTINGS, seed=seed)
    ensemble, jobs = Ensemble(settings), dict[str, RunningJob]()

    def begin(new: dict[str, Job]) -> None:
        for job_id, job in new.items():
            assignment = Assignment(job_id=job_id, epoch=0, job=job)
            jobs[job_id] = running(assignment, model, settings, sender="test")

    def carry_out(outcome: Outcome) -> None:
        for job_id in outcome.end:
            del jobs[job_id]
        begin(outcome.begin)

    sure = 0
    for scan, truth in simulated_steps(source, BridgeSettings(), world.map.digest):
        if scan.step == 0:
            begin(ensemble.begin_at(0))
        reports = [jobs[job_id].advance(scan) for job_id in sorted(jobs)]
        outcome = ensemble.advance(scan.step, reports)
        carry_out(outcome)
        rooms = copies_in_all_rooms(truth)
        if scan.step == NAMED_AT:
            x, y, _ = max(rooms, key=lambda room: hypot(room[0] - truth[0], room[1] - truth[1]))
            carry_out(ensemble.relocalize(scan.step, near=(x, y, 2.0)))
        held = [
            any(hypot(h.mean[0] - x, h.mean[1] - y) < 1.0 for h in outcome.hypotheses)
            for x, y, _ in rooms
        ]
        sure += held.count(True) == 1 and outcome.state == "localized"
    assert sure > EVERY / 2, "of the one that was named"
    assert held.count(True) == PLACES, held
    assert outcome.hypotheses[0].probability > 0.9, "a person said so"
