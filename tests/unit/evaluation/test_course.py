from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from evaluation.course import Case, RecordedRobot, course_of
from process_runtime.settings import BridgeSettings
from tests.unit.recordings.logs import flaser


@pytest.fixture
def recorded(tmp_path: Path) -> RecordedRobot:
    """A robot that drives a metre a second along the x axis, ten scans."""
    lines = [flaser(float(second), (float(second), 0.0, 0.0)) for second in range(10)]
    poses = [f"{second} {second} 0 0 0 0 0 1" for second in range(10)]
    (tmp_path / "robot.log").write_text("\n".join(lines) + "\n")
    (tmp_path / "truth.tum").write_text("\n".join(poses) + "\n")
    Image.fromarray(np.full((20, 20), 254, np.uint8)).save(tmp_path / "map.pgm")
    header = "image: map.pgm\nresolution: 1.0\norigin: [0, 0, 0]\nnegate: 0\n"
    (tmp_path / "map.yaml").write_text(header + "occupied_thresh: 0.65\nfree_thresh: 0.2\n")
    files = (tmp_path / name for name in ("robot.log", "map.yaml", "truth.tum"))
    recording, grid_map, reference = files
    return RecordedRobot(recording=recording, map=grid_map, reference=reference)


def truths(robot: RecordedRobot, start_step: int, updates: int | None) -> list[tuple[int, float]]:
    """Number of each step, and where the robot was."""
    case = Case(robot=robot, updates=updates)
    steps = course_of(case, 0, BridgeSettings(), start_step).steps
    return [(scan.step, truth[0]) for scan, truth in steps if truth is not None]


def test_a_run_has_its_start_and_its_number_of_steps(recorded: RecordedRobot) -> None:
    assert truths(recorded, 0, None) == [(step, float(step)) for step in range(10)]
    assert truths(recorded, 0, 3) == [(0, 0.0), (1, 1.0), (2, 2.0)]
    assert truths(recorded, 6, 3) == [(6, 6.0), (7, 7.0), (8, 8.0)]
    assert truths(recorded, 8, 3) == [(8, 8.0), (9, 9.0)]
