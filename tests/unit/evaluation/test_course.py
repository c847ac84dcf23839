from pathlib import Path

import numpy as np
import pytest

from clustermcl.evaluation.course import Case, RecordedRobot, course_of
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.runtime.settings import BridgeSettings
from tests.maps import write_map
from tests.unit.recordings.logs import flaser


@pytest.fixture
def recorded(tmp_path: Path) -> RecordedRobot:
    """A robot that drives a metre a second along the x axis, ten scans."""
    lines = [flaser(float(second), (float(second), 0.0, 0.0)) for second in range(10)]
    poses = [f"{second} {second} 0 0 0 0 0 1" for second in range(10)]
    (tmp_path / "robot.log").write_text("\n".join(lines) + "\n")
    (tmp_path / "truth.tum").write_text("\n".join(poses) + "\n")
    plan = write_map(GridMap(np.zeros((20, 20), np.int8), 1.0, (0.0, 0.0, 0.0)), tmp_path, "map")
    return RecordedRobot(
        recording=tmp_path / "robot.log", map=plan, reference=tmp_path / "truth.tum"
    )


def truths(robot: RecordedRobot, start_step: int, updates: int | None) -> list[tuple[int, float]]:
    case = Case(robot=robot, updates=updates)
    steps = course_of(case, 0, BridgeSettings(), start_step).steps
    return [(scan.step, truth[0]) for scan, truth in steps if truth is not None]


def test_a_run_has_its_start_and_its_number_of_steps(recorded: RecordedRobot) -> None:
    assert truths(recorded, 0, None) == [(step, float(step)) for step in range(10)]
    assert truths(recorded, 0, 3) == [(0, 0.0), (1, 1.0), (2, 2.0)]
    assert truths(recorded, 6, 3) == [(6, 6.0), (7, 7.0), (8, 8.0)]
    assert truths(recorded, 8, 3) == [(8, 8.0), (9, 9.0)]
