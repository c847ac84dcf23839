import math
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest

from coordinator.belief.outcome import Outcome, belief_after
from evaluation.course import Case, SimulatedRobot
from evaluation.in_process import outcomes
from evaluation.run import Run
from particle_filter.sensor_models import computed_model
from process_runtime.output_files import OutputError
from protocol.answers import Hypothesis
from protocol.steps import Scan
from recordings.map_file import load_map
from recordings.recording import open_recording
from recordings.run_log import RunLog
from robot_simulator.worlds.catalogue import world
from sensor_bridge.recorded import steps_of
from tests.integration.system.conftest import SMALL
from tests.unit.recordings.test_run_log import as_others_read

STEPS = 60
DIGEST = world("cross_feature").map.digest


class Recorded:
    """A run that was recorded, with what was recorded."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "run.mcap"
        self.scans: list[Scan] = []
        self.outcomes: list[Outcome] = []

        case = Case(robot=SimulatedRobot(world="cross_feature"), updates=STEPS)
        course, steps = Run(case=case, seed=3, settings=SMALL).begun()
        with RunLog.to(self.file) as log:
            for scan, outcome, _ in steps:
                if log.wants_map(scan):
                    log.on_map(course.map, scan.stamp_ns)
                log.on_scan(scan, scan.stamp_ns)
                log.on_belief(belief_after(scan, outcome, scan.sender), scan.stamp_ns)
                self.scans.append(scan)
                self.outcomes.append(outcome)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    return Recorded(tmp_path_factory.mktemp("recorded"))


def test_all_steps_and_beliefs_are_recorded(run: Recorded) -> None:
    found = as_others_read(run.file)
    counts = {topic: len(messages) for topic, messages in found.items()}
    places = sum(bool(outcome.hypotheses) for outcome in run.outcomes)
    assert counts == {
        "/map": 1, "/scan": STEPS, "/places": STEPS, "/belief": STEPS,
        "/pose": places, "/tf": STEPS + places,
    }  # fmt: skip
    for scan, message in zip(run.scans, found["/scan"], strict=True):
        seen, read = scan.ranges.array(), np.array(message["ranges"], np.float32)
        returned = (seen > 0) & (seen < scan.range_max_m)
        assert np.array_equal(read[returned], seen[returned])
        assert np.all(read[~returned] == 0.0)
    reported = [outcome for outcome in run.outcomes if outcome.hypotheses]
    for outcome, pose in zip(reported, found["/pose"], strict=True):
        at = pose["pose"]["position"]
        drawn = pytest.approx(outcome.hypotheses[0].pose[:2], abs=1e-4)
        assert (at["x"], at["y"]) == drawn


def test_the_scan_lies_on_the_walls_through_the_transforms_of_the_file(run: Recorded) -> None:
    """As a viewer draws it: map from odom from robot, of the last step."""
    links = {one["child_frame_id"]: one for one in as_others_read(run.file)["/tf"]}
    point = np.array([0.0, 0.0])
    for child in ("base_link", "odom"):
        turn, shift = links[child]["rotation"], links[child]["translation"]
        heading = 2.0 * math.atan2(turn["z"], turn["w"])
        c, s = math.cos(heading), math.sin(heading)
        point = point @ np.array([[c, s], [-s, c]]) + (shift["x"], shift["y"])
    assert links["odom"]["parent_frame_id"] == "map"
    best = run.outcomes[-1].hypotheses[0]
    assert point == pytest.approx(best.pose[:2], abs=1e-3)


def test_a_played_back_recording_gives_the_same_steps_and_beliefs(run: Recorded) -> None:
    assert load_map(run.file).digest == DIGEST, "the map is in the file"
    recording = open_recording(run.file, SMALL.bridge)
    assert recording.skipped == ()
    steps = list(steps_of(recording, SMALL.bridge, DIGEST))
    assert len(steps) == STEPS
    for scan, again in zip(run.scans, steps, strict=True):
        assert again.stamp_ns == scan.stamp_ns
        assert again.odom_from_robot == scan.odom_from_robot
        assert again.robot_from_laser == scan.robot_from_laser
    for place, same in places_of(run.scans, steps):
        assert same.probability == place.probability
        assert same.pose == place.pose


def places_of(
    scans: Iterable[Scan], others: Iterable[Scan]
) -> Iterator[tuple[Hypothesis, Hypothesis]]:
    """The places that are believed, pair by pair; the same clusters and states at every step."""
    ground = world("cross_feature").map
    grid = ground.grid
    model = computed_model(grid, SMALL.sensor)
    both = zip(outcomes(scans, model, SMALL), outcomes(others, model, SMALL), strict=True)
    for (_, one), (_, other) in both:
        assert other.state == one.state, f"step {one.step}"
        assert [h.cluster for h in other.hypotheses] == [h.cluster for h in one.hypotheses]
        yield from zip(one.hypotheses, other.hypotheses, strict=True)


def test_an_unwritable_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="folder does not exist"):
        RunLog.to(tmp_path / "nowhere" / "run.mcap")
