import math

import numpy as np
import pytest
from msgspec.structs import replace

from clustermcl.belief.explained import explains
from clustermcl.filter.arrays import OCCUPIED, Cells
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.beam_fits import BESIDE_RAD, THROUGH_M, beam_fits, decoded
from clustermcl.filter.laser.evidence_model import through_beam_loss
from clustermcl.filter.laser.likelihood_field import LikelihoodField
from clustermcl.filter.laser.sensor_model import Beams, computed_model
from clustermcl.filter.poses import between, compose
from clustermcl.filter.settings import SensorSettings
from tests.unit.coordinator.reports import tracked
from tests.unit.filter.naive_rays import cast_ray
from tests.unit.filter.rooms import plain_room

CELL_M = 0.05
MIDDLE = np.array([5.0, 5.0, 0.0])
"""Of a room of 10 m; the wall ahead begins 4.95 m away."""
AHEAD_M = 4.975


def room() -> Cells:
    cells = np.zeros((200, 200), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = OCCUPIED
    return cells


def grid(cells: Cells) -> Grid:
    return Grid(cells, CELL_M, np.zeros(3))


def fits_of(cells: Cells, sensor: SensorSettings, *ranges: float) -> bytes:
    beams = Beams(np.array(ranges), np.zeros(len(ranges)), np.zeros(3))
    return beam_fits(MIDDLE, beams, computed_model(grid(cells), sensor), mirrored=False)


def seen(cells: Cells, *ranges: float) -> tuple[list[float], list[bool]]:
    fits, through = decoded(fits_of(cells, SensorSettings(), *ranges))
    return fits.tolist(), through.tolist()


@pytest.mark.parametrize(
    ("range_m", "fits", "through"),
    [
        (AHEAD_M, (1.0, 1.0), False),
        (AHEAD_M - 0.1, (0.93, 0.98), False),
        (AHEAD_M - 0.3, (0.5, 0.7), False),
        (AHEAD_M - 1.0, (0.0, 0.0), False),
        (AHEAD_M + 0.2, (0.0, 0.0), False),
        (AHEAD_M + 1.0, (0.0, 0.0), True),
    ],
)
def test_a_beam_fits_by_the_distance_of_its_end_from_an_obstacle(
    range_m: float, fits: tuple[float, float], through: bool
) -> None:
    """Beyond the wall is the end of the map."""
    found, passed = seen(room(), range_m)
    assert fits[0] <= found[0] <= fits[1]
    assert passed == [through]


@pytest.mark.parametrize("sigma_m", [0.15, 0.01])
def test_at_full_sharpness_a_beam_explains_by_the_likelihood_of_its_distance(
    sigma_m: float,
) -> None:
    """Half a bit of its fit is some 0.02 of it."""
    sensor = SensorSettings(hit_sigma_m=sigma_m)
    for ahead_m in (0.0, 0.1, 0.2, 0.3, 1.0):
        fits = fits_of(room(), sensor, AHEAD_M - ahead_m)
        report = replace(tracked("c0", 1, 1.0, (5.0, 5.0, 0.0)), fits=fits)
        found = explains(report, np.ones(1), through_beam_loss(sensor))
        assert found is not None
        assert found.clear == found.fitting
        assert found.clear == pytest.approx(math.exp(-0.5 * (ahead_m / sigma_m) ** 2), abs=0.02)


@pytest.mark.parametrize("sharpness", [0.0, 1e-12, 1.0, 700.0, 1e6])
def test_a_beam_explains_at_most_itself_however_sharply_it_fits(sharpness: float) -> None:
    report = tracked("c0", 1, 1.0, (5.0, 5.0, 0.0), fits=[0.0, 0.5, 1.0])
    found = explains(report, np.array([0.25, 1.0, 0.5]), sharpness)
    assert found is not None
    half = 64 / 127 if sharpness < 1.0 else 1.0 / (1.0 + math.exp(min(sharpness, 700.0) * 63 / 127))
    assert found.fitting == pytest.approx(0.5 + half, abs=0.01)


def test_a_beam_that_ends_at_an_obstacle_behind_a_wall_went_through_the_wall() -> None:
    cells = room()
    cells[:, 150] = OCCUPIED
    assert seen(cells, AHEAD_M, 2.525) == ([1.0, 1.0], [True, False])


@pytest.mark.parametrize(("half_m", "is_through"), [(0.5, True), (0.05, False)])
def test_a_beam_goes_through_a_wall_if_rays_on_both_sides_are_cut_off_too(
    half_m: float, is_through: bool
) -> None:
    """A post 2 m ahead: at 0.05 rad, rays are 0.1 m beside its middle."""
    cells, half = room(), round(half_m / CELL_M)
    cells[100 - half : 100 + half, 140] = OCCUPIED
    assert seen(cells, AHEAD_M) == ([1.0], [is_through])


@pytest.mark.parametrize("cell_m", [0.05, 0.1, 0.25])
def test_the_fit_is_the_log_likelihood_in_the_field_where_a_beam_from_the_laser_ends(
    cell_m: float,
) -> None:
    cells, rng = np.zeros((60, 80), np.int8), np.random.default_rng(1)
    cells[tuple(rng.integers(0, (60, 80), (40, 2)).T)] = OCCUPIED
    ground = Grid(cells, cell_m, np.array([2.0, -1.0, 0.0]))
    model = computed_model(ground, SensorSettings())
    field = LikelihoodField.build(ground, SensorSettings())
    pose, laser = np.array([2.0 + 38 * cell_m, -1.0 + 33 * cell_m, 0.6]), np.array([0.4, -0.2, 0.3])
    angles, ranges = rng.uniform(-np.pi, np.pi, 500), rng.uniform(0.1, 40 * cell_m, 500)
    seen = beam_fits(pose, Beams(ranges, angles, laser), model, mirrored=False)
    fits, through = decoded(seen)
    from_laser = np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles), angles])
    at_laser = compose(pose, laser)
    assert seen == beam_fits(at_laser, Beams(ranges, angles, np.zeros(3)), model, mirrored=False)
    assert 20 < np.count_nonzero(through) < 480
    col, row = ((compose(at_laser, from_laser)[:, :2] - [2.0, -1.0]) / cell_m).T
    inside = (row >= 0) & (row < 60) & (col >= 0) & (col < 80)
    codes = field.codes[row[inside].astype(int) + 1, col[inside].astype(int) + 1]
    np.testing.assert_allclose(fits[inside], codes / 65_535, atol=0.01)
    assert not fits[~inside].any()


def test_rays_are_followed_as_one_by_one_in_the_grid() -> None:
    rng, cells = np.random.default_rng(5), plain_room()
    ground = Grid(cells, CELL_M, np.array([-4.0, 7.0, 0.7]))
    model, laser = computed_model(ground, SensorSettings()), np.array([0.2, -0.1, 0.0])
    size_m = CELL_M * np.array(cells.shape)[::-1]
    inside = np.column_stack((rng.random((20, 2)) * size_m, rng.uniform(-4.0, 4.0, 20)))
    x, y = rng.uniform(-4.0, 4.0, (60, 2)).T  # some of them beyond the map
    beams = Beams(np.hypot(x, y), np.arctan2(y, x), laser)
    for pose in compose(ground.map_from_grid, inside):
        _, through = decoded(beam_fits(pose, beams, model, mirrored=False))
        at_laser = compose(pose, laser)
        for index, (way_m, angle) in enumerate(zip(beams.ranges, beams.angles, strict=True)):
            start = between(ground.map_from_grid, at_laser + np.array([0.0, 0.0, angle]))
            met = [
                cast_ray(cells, CELL_M, start, turn, way_m) < way_m - THROUGH_M
                for turn in (0.0, BESIDE_RAD, -BESIDE_RAD)
            ]
            assert through[index] == all(met)


def test_the_beams_of_all_lasers_have_fits() -> None:
    back = Beams(np.array([4.6, 1.0]), np.zeros(2), np.array([-0.4, 0.0, math.pi]))
    both = Beams(np.array([AHEAD_M]), np.zeros(1), np.zeros(3), others=(back,))
    model = computed_model(grid(room()), SensorSettings())
    fits = beam_fits(MIDDLE, both, model, mirrored=False)
    found, _ = decoded(fits)
    assert found.tolist() == [1.0, 1.0, 0.0]
    mirrored = beam_fits(MIDDLE, both, model, mirrored=True)
    assert (mirrored[0], mirrored[1], mirrored[2]) == (fits[0], fits[2], fits[1])
