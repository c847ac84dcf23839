from math import hypot, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.protocol.message import PoseTuple
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.simulator import sensors
from clustermcl.simulator.free_space import FreeSpace, NoRoomError
from clustermcl.simulator.robot import RADIUS_M, Drive, Robot, driven
from clustermcl.simulator.worlds.catalogue import world

TICK_S = 0.05
EMPTY_ROOM = GridMap(np.pad(np.zeros((80, 120), np.int8), 2, constant_values=1), 0.05, (0, 0, 0))
NO_ROUTE = np.zeros((0, 2))


def wander(ground: GridMap, seed: int, ticks: int) -> tuple[list[PoseTuple], FreeSpace]:
    free_space, rng = FreeSpace(ground), np.random.default_rng(seed)
    robot = Robot(free_space, free_space.random_pose(rng), NO_ROUTE, rng)
    poses = []
    for _ in range(ticks):
        robot.move(TICK_S)
        poses.append(robot.map_from_robot)
    return poses, free_space


@pytest.mark.parametrize("name", ["cross_feature", "hall"])
def test_a_wandering_robot_drives_within_its_speeds_hits_nothing_and_rarely_stands(
    name: str,
) -> None:
    at, free_space = wander(world(name).truth, 1, 6_000)
    assert min(free_space.clearance_m(x, y) for x, y, _ in at) >= RADIUS_M
    poses = np.array(at)
    assert np.abs(np.diff(poses[::200], axis=0)).max(axis=1).min() > 0.1, "every 10 s"
    steps = np.diff(poses, axis=0)
    turns = np.abs((steps[:, 2] + pi) % (2 * pi) - pi)
    assert np.hypot(steps[:, 0], steps[:, 1]).max() <= 0.6 * TICK_S + 1e-9
    assert turns.max() <= 1.0 * TICK_S + 1e-9


def test_a_robot_follows_its_route_to_the_end() -> None:
    route = np.array([[3.0, 1.0], [5.0, 3.0], [1.0, 3.0]])
    robot = Robot(FreeSpace(EMPTY_ROOM), (1.0, 1.0, 0.0), route, np.random.default_rng(0))
    missed = [tuple(point) for point in route]
    for _ in range(600):
        robot.move(TICK_S)
        x, y, _ = robot.map_from_robot
        if missed and hypot(missed[0][0] - x, missed[0][1] - y) < 0.45:
            missed.pop(0)
    assert missed == []


def test_free_space_follows_the_pose_of_the_map() -> None:
    turned = GridMap(EMPTY_ROOM.cells, EMPTY_ROOM.cell_m, (10.0, -5.0, pi / 2))
    free_space = FreeSpace(turned)
    x, y = 10.0 - 2.1, -5.0 + 3.1  # the room's middle
    assert free_space.clearance_m(x, y) == pytest.approx(2.0, abs=0.05)
    assert free_space.clearance_m(3.1, 2.1) == 0.0  # where it would be without the turn
    pose = free_space.random_pose(np.random.default_rng(0))
    assert 6.0 < pose[0] < 10.0
    assert -5.0 < pose[1] < 1.0


def test_random_places_are_in_the_largest_connected_part() -> None:
    cells = np.ones((100, 200), np.int8)
    cells[2:98, 2:60] = 0
    cells[2:98, 64:198] = 0
    free_space, rng = FreeSpace(GridMap(cells, 0.05, (0, 0, 0))), np.random.default_rng(0)
    assert all(free_space.random_pose(rng)[0] > 64 * 0.05 for _ in range(50))


@pytest.mark.parametrize("free", [(1, 1), (8, 60), (20, 20)])
def test_a_map_too_narrow_for_the_robot_is_refused(free: tuple[int, int]) -> None:
    ground = GridMap(np.pad(np.zeros(free, np.int8), 5, constant_values=1), 0.05, (0, 0, 0))
    with pytest.raises(NoRoomError, match=r"free space 0\.6 m wide and 1\.0 m long"):
        FreeSpace(ground)


@given(
    distance_m=st.floats(-2, 2), turn_rad=st.floats(-3, 3), share=st.floats(0, 1),
    heading=st.floats(-3, 3),
)  # fmt: skip
def test_a_drive_is_the_sum_of_its_parts(
    distance_m: float, turn_rad: float, share: float, heading: float
) -> None:
    start, drive = (1.0, 2.0, heading), Drive(distance_m, turn_rad)
    half_way = driven(start, drive.part(share))
    x, y, after = driven(half_way, drive.part(1.0 - share))
    expected = driven(start, drive)
    assert (x, y) == pytest.approx(expected[:2], abs=1e-9)
    assert np.cos(after - expected[2]) == pytest.approx(1.0)


def test_odometry_errors_grow_with_the_root_of_the_distance_and_with_its_scale(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """400 robots drive 9 m straight on; each component of the error is as large as configured."""
    for name in ("SCALE_ERROR", "VEER_RAD_PER_M", "DISTANCE_NOISE_M", "TURN_NOISE_PER_METRE_RAD"):
        monkeypatch.setattr(sensors, name, 0.0)

    def read(**error: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        ends = []
        with monkeypatch.context() as patch:
            for name, size in error.items():
                patch.setattr(sensors, name, size)
            for seed in range(400):
                odometer = sensors.Odometer(np.random.default_rng(seed))
                for _ in range(90):
                    odometer.read(Drive(0.1, 0.0))
                ends.append(odometer.odom_from_robot)
        return np.array(ends)

    # The standard deviation of 400 draws is 3.5 % off at one sigma: 20 % is a false alarm in 1e8.
    assert read(SCALE_ERROR=0.02)[:, 0].std() == pytest.approx(9 * 0.02, rel=0.2)
    assert read(DISTANCE_NOISE_M=0.03)[:, 0].std() == pytest.approx(3 * 0.03, rel=0.2)
    assert read(VEER_RAD_PER_M=0.01)[:, 2].std() == pytest.approx(9 * 0.01, rel=0.2)
    assert read(TURN_NOISE_PER_METRE_RAD=0.02)[:, 2].std() == pytest.approx(3 * 0.02, rel=0.2)
    assert read()[0] == pytest.approx((9.0, 0.0, 0.0))
