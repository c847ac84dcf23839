"""Beam order, mounting, map and reference fit together: scans end on walls."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from clustermcl.evaluation.references import load_reference
from clustermcl.filter.arrays import OCCUPIED, Pose
from clustermcl.filter.laser.sensor_model import Beams, usable_beams
from clustermcl.filter.poses import compose, inverse
from clustermcl.protocol.errors import RecordingError
from clustermcl.protocol.steps import Scan
from clustermcl.recordings.log_file import SkippedLine
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.recordings.recording import Recording, open_recording
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge import recorded
from clustermcl.sensor_bridge.recorded import steps_of
from tests.unit.recordings import recording_or_skip
from tests.unit.recordings.logs import flaser, recording_of

NEAR_M = 0.3


def near_wall(grid_map: GridMap) -> NDArray[np.bool_]:
    """(rows, cols) whether an occupied cell is no farther than NEAR_M."""
    distance_m = grid_map.cell_m * distance_transform_edt(grid_map.cells != OCCUPIED)
    return np.asarray(distance_m <= NEAR_M)


def share_on_walls(
    scan: Scan, map_from_robot: Pose, grid_map: GridMap, near: NDArray[np.bool_]
) -> float:
    ranges = scan.ranges.array()
    beams = usable_beams(ranges, min(scan.range_max_m, 20.0), 90)
    mount = np.array(scan.robot_from_laser)
    points = Beams(
        ranges[beams], scan.angle_min_rad + scan.angle_step_rad * beams, mount, np.inf
    ).hits_in_robot
    ends = np.column_stack([points, np.zeros(len(points))])
    map_from_ends = compose(map_from_robot, ends)
    grid = compose(inverse(np.array(grid_map.map_from_grid)), map_from_ends)
    cols, rows = np.floor(grid[:, :2] / grid_map.cell_m).astype(int).T
    inside = (rows >= 0) & (cols >= 0) & (rows < near.shape[0]) & (cols < near.shape[1])
    return float(np.sum(near[rows[inside], cols[inside]]) / len(beams))


@pytest.mark.parametrize(
    ("log", "map_file", "reference", "steps"),
    [
        ("intel/log.clf.gz", "intel/map.yaml", "intel/groundtruth.tum", 903),
        ("crob-jarvis/log.clf.gz", "crob-jarvis/map.yaml", "crob-jarvis/groundtruth.tum", 53),
        ("aces/log.clf.gz", "aces/map.yaml", "aces/groundtruth.tum", 263),
    ],
)
def test_scans_at_the_reference_poses_end_on_walls(
    log: str, map_file: str, reference: str, steps: int
) -> None:
    recording = open_recording(recording_or_skip(log), BridgeSettings())
    grid_map = load_map(recording_or_skip(map_file))
    truth = load_reference(recording_or_skip(reference))
    scans = list(steps_of(recording, BridgeSettings(), grid_map.digest))
    assert len(scans) == steps
    assert [scan.step for scan in scans] == list(range(steps))
    near = near_wall(grid_map)
    shares = []
    for scan in scans[:: len(scans) // 20]:
        pose = truth.pose_at(scan.stamp_ns)
        assert pose is not None
        shares.append(share_on_walls(scan, np.array(pose), grid_map, near))
    assert np.mean(shares) > 0.8  # measured 0.87 to 0.99; with mirrored beams 0.2 to 0.6


def test_a_recording_without_a_usable_scan_is_refused(tmp_path: Path) -> None:
    recording = recording_of(tmp_path, *(flaser(t, ranges=["nan"] * 180) for t in range(3)))
    with pytest.raises(RecordingError, match=r"none of its 3 scans can be used \(no_returns: 3\)"):
        list(steps_of(recording, BridgeSettings(), "digest"))


X, CUT = "'x' is not a number", "cut"


@pytest.mark.parametrize(("skipped", "words"), [
    ((SkippedLine(3, X), SkippedLine(9, CUT)),
     f"robot.log:3: 2 bad lines left out (3, 9); the first: {X}"),
    (tuple(SkippedLine(number, CUT) for number in range(1, 40)),
     "39 bad lines left out (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, ...)"),
    ((), ""),
], ids=["the first is explained", "ten of many are named", "no bad line, no warning"])  # fmt: skip
def test_bad_lines_that_are_left_out_are_counted(
    skipped: tuple[SkippedLine, ...],
    words: str,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    recording = Recording(Path("robot.log"), (), skipped)
    monkeypatch.setattr(recorded, "open_recording", lambda *_: recording)
    recorded.opened("robot.log", BridgeSettings())
    assert words in caplog.text
    assert bool(skipped) == bool(caplog.text)
