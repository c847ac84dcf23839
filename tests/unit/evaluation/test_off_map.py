import itertools
from pathlib import Path

import numpy as np
import pytest

from benchmarks.experiments.case import SimulatedRobot
from clustermcl.belief.outcome import Outcome
from clustermcl.evaluation.course import Case, RecordedRobot, course_of
from clustermcl.jobs.in_process import outcomes
from clustermcl.jobs.map_model import sensor_model
from clustermcl.protocol.steps import mirrored
from clustermcl.runtime.settings import BridgeSettings, Settings
from tests.unit.recordings import recording_or_skip


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
