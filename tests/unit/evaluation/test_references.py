import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.evaluation.measures import pose_error
from clustermcl.evaluation.references import load_reference
from clustermcl.evaluation.run import Case, RecordedRobot, course_of
from clustermcl.protocol.errors import ReferenceFileError
from clustermcl.protocol.message import PoseTuple
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.runtime.settings import BridgeSettings
from tests.maps import write_map
from tests.unit.recordings.logs import flaser

TRUTH: PoseTuple = (10.0, 5.0, 3.0)


@pytest.mark.parametrize(
    ("pose", "right"),
    [
        ((10.99, 5.0, 3.0), True),
        ((11.01, 5.0, 3.0), False),
        ((10.0, 5.0, 3.0 + math.radians(19.9) - math.tau), True),
        ((10.0, 5.0, 3.0 + math.radians(20.1)), False),
    ],
)
def test_right_is_within_a_metre_and_twenty_degrees(pose: PoseTuple, right: bool) -> None:
    assert pose_error(pose, TRUTH).right is right


@given(st.tuples(*[st.floats(-50, 50)] * 3), st.tuples(*[st.floats(-50, 50)] * 3))
def test_errors_are_symmetric_and_never_more_than_half_a_turn(a: PoseTuple, b: PoseTuple) -> None:
    there, back = pose_error(a, b), pose_error(b, a)
    assert there.distance_m == back.distance_m >= 0.0
    assert there.heading_rad == pytest.approx(back.heading_rad, abs=1e-9)
    assert 0.0 <= there.heading_rad <= math.pi


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


S = 1_000_000_000


def line(stamp: object, x: float = 0.0, y: float = 0.0, heading: float = 0.0) -> str:
    return f"{stamp} {x} {y} 0 0 0 {math.sin(heading / 2)} {math.cos(heading / 2)}\n"


def write(folder: Path, *lines: str) -> Path:
    path = folder / "reference.tum"
    path.write_text("".join(("# timestamp x y z qx qy qz qw\n", *lines)))
    return path


@given(heading=st.floats(-3.14, 3.14))
def test_the_heading_of_a_quaternion_comes_back(
    tmp_path_factory: pytest.TempPathFactory, heading: float
) -> None:
    folder = tmp_path_factory.mktemp("heading")
    reference = load_reference(write(folder, line(1, 2.0, 3.0, heading)))
    assert reference.pose_at(S) == pytest.approx((2.0, 3.0, heading), abs=1e-9)


def test_a_robot_that_leans_has_the_heading_seen_from_above(tmp_path: Path) -> None:
    # a turn by 0.5 about z, then a pitch by 0.2 about y
    z, y = 0.25, 0.1
    qx, qy = -math.sin(z) * math.sin(y), math.cos(z) * math.sin(y)
    qz, qw = math.sin(z) * math.cos(y), math.cos(z) * math.cos(y)
    reference = load_reference(write(tmp_path, f"1 0 0 0 {qx} {qy} {qz} {qw}\n"))
    assert reference.pose_at(S) == pytest.approx((0, 0, 0.5))


def test_outside_the_known_times_the_end_poses_hold_for_a_second(tmp_path: Path) -> None:
    lines = line(11, 2), line(10, 1), line(10, 7)  # stamps may step back; the first of two counts
    reference = load_reference(write(tmp_path, *lines))
    assert reference.pose_at(9 * S) == (1.0, 0.0, 0.0)
    assert reference.pose_at(12 * S) == (2.0, 0.0, 0.0)
    assert reference.pose_at(9 * S - 1) is None
    assert reference.pose_at(12 * S + 1) is None


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "no pose in it"),
        ("1 2 3\n", ":3: 3 numbers, a TUM line has 8"),
        (line(1).replace("0 0 0", "0 0 x"), ":3: could not convert string to float: 'x'"),
        (line("soon"), ":3: the time 'soon' is not a number"),
        ("1 0 nan 0 0 0 0 1\n", ":3: (0 nan 0) is not a position"),
        ("1 0 0 0 0 0 0 0\n", ":3: the orientation is not a unit quaternion: its length is 0"),
        ("1 0 0 0 nan 0 0 1\n", ":3: the orientation is not a unit quaternion"),
    ],
)
def test_a_broken_reference_is_refused_with_the_line(
    tmp_path: Path, text: str, problem: str
) -> None:
    path = write(tmp_path, *((line(0), text) if text else ()))
    with pytest.raises(ReferenceFileError) as caught:
        load_reference(path)
    assert problem in str(caught.value)
