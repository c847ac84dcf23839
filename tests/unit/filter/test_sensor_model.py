from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN, Cells, Pose
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.evidence_model import scan_exponent
from clustermcl.filter.laser.sensor_model import (
    Beams,
    LaserScan,
    SensorModel,
    computed_model,
    ground_log_penalty,
    usable_beams,
)
from clustermcl.filter.poses import compose
from clustermcl.filter.settings import SensorSettings
from tests.unit.filter import naive
from tests.unit.filter.naive_rays import cast_rays
from tests.unit.filter.rooms import CELL_M, NO_OFFSET, model_of, plain_room, scan_of

FEW = SensorSettings(max_range_m=10.0, max_beams=4)
FIELD = model_of(plain_room(), FEW)
NO_RETURN, BROKEN = np.inf, np.nan


def beams_of(ranges: list[float], model: SensorModel) -> Beams:
    return model.beams(LaserScan(np.array(ranges), 30.0, -1.0, 0.1, np.zeros(3)))


def test_a_beam_without_return_does_not_count_and_others_keep_their_directions() -> None:
    beams = beams_of([1.0, NO_RETURN, BROKEN, 40.0, -2.0, 3.0], FIELD)
    assert list(beams.ranges) == [1.0, 3.0]
    np.testing.assert_allclose(beams.angles, [-1.0, -0.5])


@pytest.mark.parametrize(
    ("beams", "independent"), [(200, 20.0), (60, 6.0), (59, 6.0), (16, 6.0), (6, 6.0), (4, 4.0)]
)
def test_a_scan_of_few_beams_counts_as_six_independent_beams_or_as_many_as_it_has(
    beams: int, independent: float
) -> None:
    settings = SensorSettings(scan_likelihood_exponent=0.1, max_beams=60)
    assert beams * scan_exponent(beams, settings) == pytest.approx(independent)


@pytest.mark.parametrize("beams", [0, 1, 4, 60])
def test_an_exponent_of_one_counts_every_beam_of_a_scan(beams: int) -> None:
    assert scan_exponent(beams, SensorSettings(scan_likelihood_exponent=1.0)) == 1.0


def test_a_map_without_obstacles_is_refused() -> None:
    with pytest.raises(ValueError, match="no occupied cell"):
        computed_model(Grid(np.zeros((3, 3), np.int8), 0.1, NO_OFFSET), SensorSettings())


def test_arrays_of_another_map_are_refused() -> None:
    settings = SensorSettings()
    grid, rooms = (Grid(np.tile(plain_room(), (n, n)), CELL_M, NO_OFFSET) for n in (1, 9))
    arrays, others = (SensorModel.arrays_of(of, settings) for of in (grid, rooms))
    for part in arrays:
        for wrong in (others[part], arrays[part].astype(np.float32)):
            with pytest.raises(ValueError, match="expected uint"):
                SensorModel.from_arrays(grid, {**arrays, part: wrong}, settings)


# --- several lasers -----------------------------------------------------------------------------

FRONT, REAR = np.array([0.4, 0.1, 0.0]), np.array([-0.5, 0.0, np.pi])
TRUTH = np.array([1.6, 2.5, 0.3])


def half(mount: Pose, room: Cells) -> LaserScan:
    """What a laser with a field of half a turn sees from the truth."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, 90)
    seen = compose(TRUTH, mount)
    ranges = cast_rays(room, CELL_M, seen, angles, 20.0)
    return scan_of(ranges, 20.0, angles, mount)


def both(room: Cells) -> tuple[LaserScan, LaserScan, LaserScan]:
    front, rear = half(FRONT, room), half(REAR, room)
    return front, rear, replace(front, others=(rear,))


def test_two_lasers_weigh_as_much_as_each_alone_together() -> None:
    room = plain_room()
    sensor = model_of(room, SensorSettings(max_beams=200))
    poses = TRUTH + np.random.default_rng(1).normal(0.0, 0.3, (50, 3))
    first, second, merged = (sensor.beams(scan) for scan in both(room))
    assert merged.count == first.count + second.count
    alone = sensor.log_likelihood(poses, first) + sensor.log_likelihood(poses, second)
    np.testing.assert_allclose(sensor.log_likelihood(poses, merged), alone, rtol=1e-12)


@pytest.mark.parametrize(("most", "each"), [(60, 30), (1, 1)])
def test_lasers_share_the_beams_that_are_scored_and_each_has_one(most: int, each: int) -> None:
    merged = model_of(plain_room(), SensorSettings(max_beams=most)).beams(both(plain_room())[2])
    assert [len(laser.ranges) for laser in merged.lasers] == [each, each]


def test_a_laser_that_sees_nothing_leaves_the_other_as_it_is() -> None:
    room = plain_room()
    sensor = model_of(room, SensorSettings(max_beams=200))
    front, rear, _ = both(room)
    blind = replace(rear, ranges=np.full(90, np.nan))
    first, merged = sensor.beams(front), sensor.beams(replace(front, others=(blind,)))
    np.testing.assert_array_equal(
        sensor.log_likelihood(TRUTH[None], merged), sensor.log_likelihood(TRUTH[None], first)
    )


def test_a_grid_is_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        Grid(plain_room(), CELL_M, NO_OFFSET).cells[0, 0] = 0


readings = st.one_of(
    st.floats(0.01, 9.99), st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -1.0, 10.0, 81.9])
)
scans = st.lists(readings, max_size=50).map(np.array)


@given(ranges=scans, max_beams=st.integers(1, 60))
def test_only_valid_beams_are_used_up_to_the_limit(
    ranges: NDArray[np.float64], max_beams: int
) -> None:
    valid = {i for i, r in enumerate(ranges) if 0 < r < 10.0}  # false for NaN
    chosen = usable_beams(ranges, 10.0, max_beams)
    assert set(chosen.tolist()) <= valid
    assert len(chosen) == min(len(valid), max_beams)
    assert (np.diff(chosen) > 0).all()


@given(count=st.integers(1, 400), max_beams=st.integers(1, 400))
def test_valid_beams_are_thinned_evenly(count: int, max_beams: int) -> None:
    chosen = usable_beams(np.ones(count), 10.0, max_beams)
    steps = np.diff(chosen)
    assert len(steps) == 0 or steps.max() - steps.min() <= 1
    if count > max_beams:  # the same margin at both ends, up to one beam
        assert abs(int(chosen[0]) - (count - 1 - int(chosen[-1]))) <= 1


@given(angle_min=st.floats(-4, 4), x=st.floats(-1, 1), y=st.floats(-1, 1), turn=st.floats(-4, 4))
def test_points_are_the_laser_pose_composed_with_the_beam(
    angle_min: float, x: float, y: float, turn: float
) -> None:
    laser, ranges = np.array([x, y, turn]), np.array([0.5, 7.0, 2.0])
    points = Beams(ranges, angle_min + 0.1 * np.arange(3), laser).hits_in_robot
    for i, point in enumerate(points):
        beam = np.array([0.0, 0.0, angle_min + 0.1 * i])
        end = compose(compose(laser, beam), np.array([ranges[i], 0.0, 0.0]))
        np.testing.assert_allclose(point, end[:2], atol=1e-12)


CELLS = np.array([[FREE, OCCUPIED], [UNKNOWN, FREE], [FREE, FREE]], np.int8)
GRID = Grid(CELLS, 1.0, np.zeros(3))


def test_poses_that_are_not_finite_are_penalised() -> None:
    poses = np.array([[np.nan, 0.5, 0.0], [0.5, np.inf, 0.0], [1e300, -1e300, 0.0]])
    assert ground_log_penalty(poses, GRID, -2.0).tolist() == [-2.0] * 3


@given(seed=st.integers(0, 2**32), turn=st.floats(-4, 4))
def test_the_kernel_agrees_with_the_naive_loop(seed: int, turn: float) -> None:
    rng = np.random.default_rng(seed)
    cells = rng.integers(-1, 2, (7, 9)).astype(np.int8)
    cells.flags.writeable = False
    map_from_grid = np.array([*rng.uniform(-3, 3, 2), turn])
    poses = rng.uniform(-6, 6, (40, 3))
    np.testing.assert_array_equal(
        ground_log_penalty(poses, Grid(cells, 0.5, map_from_grid), -1.5),
        naive.ground_log_penalty(poses, cells, 0.5, map_from_grid, -1.5),
    )
