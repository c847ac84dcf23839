"""A run that is recorded as a rosbag2, read by other eyes and played back into the system."""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from coordinator.belief.outcome import Outcome
from evaluation.evaluate import EvaluateOptions, run_evaluate
from evaluation.experiments.case import Case, SimulatedRobot
from evaluation.experiments.task import Run, Task
from evaluation.in_process import outcomes
from particle_filter.sensor_model import Grid
from particle_filter.sensor_models import computed_model
from process_runtime.output_files import OutputError
from protocol.answers import Hypothesis
from protocol.arrays import ArrayBlob
from protocol.errors import SettingsError
from protocol.steps import LaserBeams, Scan
from recordings.map_file import load_map
from recordings.recording import open_recording
from recordings.run_recorder import RunRecorder
from robot_simulator.worlds.catalogue import world
from sensor_bridge.recorded import steps_of
from tests.integration.system.conftest import SMALL

STEPS = 60
DIGEST = world("cross_feature").map.digest


class Recorded:
    """A run that was recorded, with what was recorded."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "run.mcap"
        robot = SimulatedRobot(world="cross_feature")
        case = Case(name="run", title="run", robot=robot, updates=STEPS, seeds=1, baselines=())
        task = Task(
            case=case, algorithm="cluster-mcl", seed=3, settings=SMALL,
            cache_folder=folder / "cache", record=self.file,
        )  # fmt: skip
        run = Run(task)
        self.scans: list[Scan] = []
        follow = run._follow

        def overheard(scans: Any, model: Any, settings: Any) -> Any:
            for scan, outcome in follow(scans, model, settings):
                self.scans.append(scan)
                yield scan, outcome

        run._follow = overheard
        self.outcomes: list[Outcome] = list(run.outcomes())


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    return Recorded(tmp_path_factory.mktemp("recorded"))


def messages_in(file: Path) -> dict[str, list[Any]]:
    """By topic; the definitions are those in the file, not those it was written with."""
    found: dict[str, list[Any]] = defaultdict(list)
    with AnyReader([file], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        for connection, _, data in reader.messages():
            found[connection.topic].append(reader.deserialize(data, connection.msgtype))
    return found


def heading_of(turn: Any) -> float:
    return 2.0 * math.atan2(turn.z, turn.w)


def test_a_stranger_reads_all_that_was_recorded(run: Recorded) -> None:
    found = messages_in(run.file)
    assert {topic: len(messages) for topic, messages in found.items() if topic != "/tf"} == {
        "/map": 1, "/tf_static": 1, "/scan": STEPS, "/particle_cloud": STEPS, "/hypotheses": STEPS,
        "/belief": STEPS,
        "/amcl_pose": sum(bool(outcome.hypotheses) for outcome in run.outcomes),
    }  # fmt: skip
    (grid,) = found["/map"]
    ground = world("cross_feature").map
    assert (grid.info.height, grid.info.width) == ground.cells.shape
    assert np.array_equal(grid.data == 100, ground.cells.ravel() == 1)
    for scan, message in zip(run.scans, found["/scan"], strict=True):
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == scan.stamp_ns
        seen = scan.ranges.array()
        returned = (seen > 0) & (seen < scan.range_max_m)
        assert np.array_equal(message.ranges[returned], seen[returned])
        assert np.all(np.isinf(message.ranges[~returned]))


def test_what_was_believed_is_in_the_file(run: Recorded) -> None:
    found = messages_in(run.file)
    told = [outcome for outcome in run.outcomes if outcome.hypotheses]
    for outcome, pose in zip(told, found["/amcl_pose"], strict=True):
        best = outcome.hypotheses[0]
        at = pose.pose.pose
        seen = (at.position.x, at.position.y, heading_of(at.orientation))
        assert seen == pytest.approx(best.mean, abs=1e-9)
        variances = pose.pose.covariance[[0, 7, 35]]
        assert tuple(variances) == pytest.approx(best.covariance[::4])
    for outcome, drawn in zip(run.outcomes, found["/hypotheses"], strict=True):
        texts = [marker.text for marker in drawn.markers if marker.ns == "probability"]
        assert texts == [f"{100 * place.probability:.0f} %" for place in outcome.hypotheses]
    cloud = [(pose.position.x, pose.position.y) for pose in found["/particle_cloud"][-1].poses]
    last = run.outcomes[-1].hypotheses
    mean = np.sum([np.multiply(place.probability, place.mean[:2]) for place in last], axis=0)
    assert np.hypot(*(np.mean(cloud, axis=0) - mean)) < 1.0, "places are some ten metres apart"


def test_the_scan_lies_on_the_walls_through_the_transforms_of_the_file(run: Recorded) -> None:
    """As a viewer draws it: map from odom from robot from laser, of the last step."""
    found = messages_in(run.file)
    links = {one.child_frame_id: one for message in found["/tf"] for one in message.transforms}
    links |= {one.child_frame_id: one for m in found["/tf_static"] for one in m.transforms}
    points = np.array([[0.0, 0.0]])
    for child in ("base_link", "odom"):
        move = links[child].transform
        c, s = math.cos(heading_of(move.rotation)), math.sin(heading_of(move.rotation))
        points = points @ np.array([[c, s], [-s, c]]) + (move.translation.x, move.translation.y)
    assert links["odom"].header.frame_id == "map"
    best = run.outcomes[-1].hypotheses[0]
    assert points[0] == pytest.approx(best.mean[:2], abs=1e-9)


def test_what_is_played_back_makes_the_same_steps_and_beliefs(run: Recorded) -> None:
    assert load_map(run.file).digest == DIGEST, "the map is in the bag"
    recording = open_recording(run.file, SMALL.bridge)
    assert recording.skipped == ()
    steps = list(steps_of(recording, SMALL.bridge, DIGEST))
    assert len(steps) == STEPS
    for scan, again in zip(run.scans, steps, strict=True):
        assert again.stamp_ns == scan.stamp_ns
        assert again.odom_from_robot == pytest.approx(scan.odom_from_robot, abs=1e-12)
        assert again.robot_from_laser == pytest.approx(scan.robot_from_laser, abs=1e-12)
    # ROS has angles of beams in 32 bits; but for that and the last bits of what tf composes,
    # nothing is lost.
    for place, same in places_of(map(in_32_bits, run.scans), steps):
        assert same.probability == pytest.approx(place.probability, abs=1e-6)
        assert same.mean == pytest.approx(place.mean, abs=1e-9)


def in_32_bits(scan: Scan) -> Scan:
    start, step = np.float32(scan.angle_min_rad), np.float32(scan.angle_step_rad)
    return msgspec.structs.replace(scan, angle_min_rad=float(start), angle_step_rad=float(step))


def places_of(
    scans: Iterable[Scan], others: Iterable[Scan]
) -> Iterator[tuple[Hypothesis, Hypothesis]]:
    """The places that are believed, pair by pair; the same clusters and states at every step."""
    ground = world("cross_feature").map
    grid = Grid(ground.cells, ground.cell_m, np.array(ground.map_from_grid))
    model = computed_model(grid, SMALL.sensor)
    both = zip(outcomes(scans, model, SMALL), outcomes(others, model, SMALL), strict=True)
    for (_, one), (_, other) in both:
        assert other.state == one.state, f"step {one.step}"
        assert [h.cluster for h in other.hypotheses] == [h.cluster for h in one.hypotheses]
        yield from zip(one.hypotheses, other.hypotheses, strict=True)


def test_every_laser_of_a_step_is_recorded_in_a_frame_of_its_own(tmp_path: Path) -> None:
    beams = LaserBeams(
        robot_from_laser=(-0.4, 0.0, math.pi), angle_min_rad=-1.0, angle_step_rad=0.5,
        range_max_m=10.0, ranges=ArrayBlob.of(np.array([1.0, 2.0]), "float32"),
    )  # fmt: skip
    scan = Scan(
        sender="bridge", step=0, stamp_ns=5, odom_from_robot=(0.0, 0.0, 0.0),
        robot_from_laser=(0.4, 0.0, 0.0), angle_min_rad=-1.0, angle_step_rad=0.5, range_max_m=10.0,
        ranges=beams.ranges, map_digest="", others=(beams,),
    )  # fmt: skip
    with RunRecorder.to(tmp_path / "run.mcap") as recorder:
        recorder.on_scan(scan)
    found = messages_in(tmp_path / "run.mcap")
    assert [one.header.frame_id for one in found["/scan"]] == ["laser", "laser_1"]
    moved = {one.child_frame_id: one for m in found["/tf"] for one in m.transforms}
    assert moved["laser_1"].transform.translation.x == -0.4


def test_a_file_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="folder does not exist"):
        RunRecorder.to(tmp_path / "nowhere" / "run.mcap")
    with pytest.raises(SettingsError, match="of one run"):
        run_evaluate(
            EvaluateOptions(recording="sim:cross", seeds=2, steps=3, record=tmp_path / "run.mcap"),
            SMALL,
        )
