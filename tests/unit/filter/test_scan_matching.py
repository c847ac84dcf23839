"""Two scans say how the robot has moved, where its odometry says otherwise."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from clustermcl.filter.arrays import OCCUPIED, Cells, Pose
from clustermcl.filter.laser.scan_matching import motion_by_scans
from clustermcl.filter.laser.sensor_model import LaserScan
from clustermcl.filter.poses import between, compose
from tests.unit.filter.naive_rays import cast_rays
from tests.unit.filter.rooms import CELL_M, plain_room, scan_of

ANGLES = np.linspace(-np.pi, np.pi, 180, endpoint=False)
MOUNT = np.array([0.1, 0.05, 0.2])
START = np.array([2.6, 2.8, 0.4])
AHEAD, BACK = np.array([0.3, 0.0, 0.05]), np.array([-0.3, 0.0, 0.05])
RANGE_M = 8.0


def seen(cells: Cells, map_from_robot: Pose, mount: Pose = MOUNT) -> LaserScan:
    ranges = cast_rays(cells, CELL_M, compose(map_from_robot, mount), ANGLES, RANGE_M)
    return scan_of(ranges, RANGE_M, ANGLES, mount)


def matched(cells: Cells, motion: Pose, by_odometry: Pose, start: Pose = START) -> Pose | None:
    return motion_by_scans(seen(cells, start), seen(cells, compose(start, motion)), by_odometry)


@pytest.mark.parametrize(
    ("motion", "by_odometry"),
    [
        (AHEAD, BACK),
        (BACK, AHEAD),
        (np.zeros(3), np.array([0.7, 0.0, 0.0])),
        (np.array([0.0, 0.0, 0.3]), np.array([0.3, 0.0, -0.1])),
    ],
    ids=["reversed", "reversed back", "wheels spin", "turns instead"],
)
def test_scans_show_a_motion_that_odometry_contradicts(motion: Pose, by_odometry: Pose) -> None:
    found = matched(plain_room(), motion, by_odometry)
    assert found is not None
    along, across, turn = between(motion, found)
    assert math.hypot(along, across) < 0.1
    assert abs(turn) < 0.05


@pytest.mark.parametrize("noise", [(0.0, 0.0, 0.0), (0.06, -0.03, 0.0), (0.0, 0.02, 0.06)])
def test_scans_say_nothing_where_odometry_may_be_right(noise: tuple[float, ...]) -> None:
    assert matched(plain_room(), AHEAD, AHEAD + np.array(noise)) is None


def test_a_corridor_shows_no_drive_along_it() -> None:
    corridor = np.zeros((40, 800), np.int8)
    corridor[[0, -1], :] = OCCUPIED
    start = np.array([20.0, 1.0, 0.0])
    assert matched(corridor, AHEAD, BACK, start) is None
    turned = matched(corridor, AHEAD, AHEAD + np.array([0.0, 0.0, 0.35]), start)
    assert turned is not None, "but it shows a turn"
    assert between(AHEAD, turned) == pytest.approx([0.0, 0.0, 0.0], abs=0.1)


def test_a_robot_that_was_carried_to_another_room_has_not_moved_by_scans() -> None:
    elsewhere = np.zeros((200, 200), np.int8)
    elsewhere[[0, -1], :] = elsewhere[:, [0, -1]] = elsewhere[40:90, 60:63] = OCCUPIED
    before, after = seen(plain_room(), START), seen(elsewhere, np.array([5.0, 6.0, 1.0]))
    assert motion_by_scans(before, after, AHEAD) is None


def test_a_few_beams_say_nothing() -> None:
    few = scan_of(np.full(12, 2.0), RANGE_M, ANGLES[::15])
    assert motion_by_scans(few, few, AHEAD) is None
    assert motion_by_scans(few, seen(plain_room(), START), AHEAD) is None


@given(
    arrays.arrays(np.float32, (2, 30), elements=st.floats(width=32)),
    st.tuples(st.floats(-10.0, 10.0), st.floats(1e-300, 0.2)),
    st.tuples(*[st.floats(-1e6, 1e6)] * 3),
    st.floats(1.0),
)
def test_any_scans_give_a_finite_motion_or_none(
    ranges: np.ndarray, angles: tuple[float, float], motion: Pose, range_max_m: float
) -> None:
    before, after = (LaserScan(each, range_max_m, *angles, MOUNT) for each in ranges)
    found = motion_by_scans(before, after, np.array(motion))
    assert found is None or np.isfinite(found).all()
