"""Eight rooms exactly alike: the belief keeps all of them, or finds the missing ones again."""

import itertools
from collections.abc import Iterator
from math import dist, hypot
from pathlib import Path

import numpy as np
import pytest

from benchmarks.experiments.case import SimulatedRobot
from clustermcl.belief.outcome import Outcome
from clustermcl.evaluation.run import Case, RecordedRobot, course_of
from clustermcl.filter.settings import BeliefSettings, FilterSettings
from clustermcl.jobs.in_process import InProcess, outcomes
from clustermcl.jobs.map_model import sensor_model
from clustermcl.protocol.answers import Hypothesis
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan, mirrored
from clustermcl.runtime.settings import BridgeSettings, Settings
from clustermcl.simulator.simulation import Simulation, simulated_steps
from tests.soak.eight_rooms import PLACES, copies_in_all_rooms, eight_rooms
from tests.unit.recordings import recording_or_skip

FOUND_WITHIN = 40
NAMED_AT, EVERY, STEPS = 5, 30, 70
WORLD = eight_rooms()


def near(places: tuple[Hypothesis, ...], pose: PoseTuple, within_m: float) -> list[Hypothesis]:
    return [place for place in places if dist(place.pose[:2], pose[:2]) < within_m]


@pytest.mark.parametrize(("seed", "lifted_at"), [(1, 150), (11, 337)])
def test_a_kidnapped_robot_is_tracked_in_all_eight_rooms(
    seed: int, lifted_at: int, tmp_path: Path
) -> None:
    """Kidnapped in the middle of a periodic search (11), and at once after one (1)."""
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

    settings = FilterSettings()
    for _, outcome in outcomes(
        scans(), sensor_model(WORLD.map, settings.sensor, tmp_path), settings
    ):
        sure = max((place.probability for place in outcome.hypotheses), default=0.0)
        assert sure < 0.5, f"update {len(truths)}"
    rooms = copies_in_all_rooms(truths[-1])
    shares = [sum(p.probability for p in near(outcome.hypotheses, room, 0.5)) for room in rooms]
    assert min(shares) > 0.02, shares
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


def run(
    robot: SimulatedRobot | RecordedRobot, cache: Path, steps: int, *, mirror: bool = False
) -> list[Outcome]:
    course, settings = course_of(Case(robot=robot), 1, BridgeSettings()), Settings()
    model = sensor_model(course.map, settings.sensor, cache)
    made = itertools.islice(course.steps, steps)
    scans = (mirrored(scan) if mirror else scan for scan, _ in made)
    return [outcome for _, outcome in outcomes(scans, model, settings)]


def localized(outcomes_of: list[Outcome]) -> float:
    return float(np.mean([outcome.state == "localized" for outcome in outcomes_of]))


def test_the_mirrored_robot_of_a_hall_is_soon_off_the_map(tmp_path: Path) -> None:
    hall = SimulatedRobot(world="hall")
    right = run(hall, tmp_path, 60)
    assert localized(right) > 0.95
    assert max(outcome.off_map_probability for outcome in right[1:]) < 0.06  # 0.05 at first
    assert right[-1].off_map_probability < 0.01
    wrong = run(hall, tmp_path, 60, mirror=True)
    assert localized(wrong) <= 0.02
    assert any(outcome.state == "lost" for outcome in wrong[:30])
    assert wrong[-1].off_map_probability > 0.5
    lost = [outcome.state == "lost" for outcome in wrong]
    assert all(lost[30:]), "and it stays so"
    assert any("d0" in outcome.begin for outcome in wrong)
    for outcome in (*right, *wrong):
        held = sum(place.probability for place in outcome.hypotheses)
        assert held + outcome.elsewhere_probability == pytest.approx(1.0)
        assert outcome.off_map_probability <= outcome.elsewhere_probability


@pytest.mark.parametrize("name", ["intel", "fr101"])
def test_the_mirrored_robot_of_a_recording_is_off_the_map(name: str, tmp_path: Path) -> None:
    recording, map_file = (recording_or_skip(f"{name}/{f}") for f in ("log.clf.gz", "map.yaml"))
    robot = RecordedRobot(recording=recording, map=map_file, reference=None)
    outcomes_of = run(robot, tmp_path, 60, mirror=True)
    assert localized(outcomes_of) <= 0.02
    assert outcomes_of[-1].off_map_probability > 0.5
    assert localized(run(robot, tmp_path, 40)) > 0.8
