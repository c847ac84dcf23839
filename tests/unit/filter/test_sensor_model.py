from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from clustermcl.filter.arrays import Cells, LogWeights, Pose, Poses
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.beam_model import BeamModel
from clustermcl.filter.laser.evidence_model import scan_exponent
from clustermcl.filter.laser.likelihood_field_model import LikelihoodFieldModel
from clustermcl.filter.laser.sensor_model import Beams, LaserScan, SensorModel
from clustermcl.filter.laser.sensor_models import computed_model, model_class
from clustermcl.filter.poses import compose
from clustermcl.filter.settings import SensorModelName, SensorSettings
from tests.unit.filter.naive_rays import cast_rays
from tests.unit.filter.rooms import (
    CELL_M,
    NO_OFFSET,
    beam_model_of,
    divided_room,
    model_of,
    plain_room,
    scan_of,
    seen_from,
)

FEW = SensorSettings(max_range_m=10.0, max_beams=4)
BEAM, FIELD = beam_model_of(plain_room(), FEW), model_of(plain_room(), FEW)
NO_RETURN, BROKEN = np.inf, np.nan
NAMES = get_args(SensorModelName)
every_model = pytest.mark.parametrize("name", NAMES)


def beams_of(ranges: list[float], model: SensorModel) -> Beams:
    return model.beams(LaserScan(np.array(ranges), 30.0, -1.0, 0.1, np.zeros(3)))


def test_a_beam_without_return_counts_for_the_beam_model_only() -> None:
    ranges = [1.0, NO_RETURN, BROKEN, 40.0, -2.0, 3.0]
    beams = beams_of(ranges, BEAM)
    assert list(beams.ranges) == [1.0, 10.0, 10.0, 3.0]
    assert beams.returned.tolist() == [True, False, False, True], "others have no end point"
    assert list(beams_of(ranges, FIELD).ranges) == [1.0, 3.0]


def test_each_beam_keeps_its_direction_when_others_are_dropped() -> None:
    beams = beams_of([1.0, BROKEN, 2.0], FIELD)
    np.testing.assert_allclose(beams.angles, [-1.0, -0.8])


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


def test_each_model_name_selects_another_class() -> None:
    assert model_class("likelihood_field") is LikelihoodFieldModel
    assert model_class("beam") is BeamModel
    assert len({model_class(name) for name in NAMES}) == len(NAMES)


def test_an_unknown_model_name_is_refused() -> None:
    with pytest.raises(ValueError, match="no sensor_model 'third' is installed"):
        model_class("third")
    with pytest.raises(ValueError, match="no sensor_model 'third' is installed"):
        SensorSettings(model="third")


def test_the_correction_is_a_share_of_the_score_of_occluded_beams() -> None:
    """The beam model followed every ray, and has given nothing for such a beam."""
    room, here = plain_room(), np.array([[1.0, 3.0, 0.3]])
    given = SensorSettings(scan_likelihood_exponent=0.5, occlusion_weight=0.2)
    beams, field = seen_from(here[0], room), model_of(divided_room(), given)
    hidden = field.mean_occluded(here, np.ones(1), beams)
    assert hidden > 10.0
    assert field.correction(here, np.ones(1), beams) == pytest.approx(0.1 * hidden)
    assert beam_model_of(divided_room(), given).correction(here, np.ones(1), beams) == 0.0


def test_several_lasers_sharing_particles_weigh_all_beams_equally(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """All particles are equal, so any subset gives the same, unless beams count unevenly."""
    room, here = plain_room(), np.tile([1.0, 3.0, 0.3], (200, 1))
    beams, field = seen_from(here[0], room), model_of(divided_room(), SensorSettings())
    weights, looked_from = np.full(200, 1 / 200), list[int]()
    whole = LikelihoodFieldModel.occluded

    def counted(model: LikelihoodFieldModel, poses: Poses, seen: Beams) -> LogWeights:
        looked_from.append(len(poses))
        return whole(model, poses, seen)

    monkeypatch.setattr(LikelihoodFieldModel, "occluded", counted)
    reported = [field.correction(here, weights, beams, sharers) for sharers in (1, 4, 7, 100)]
    assert looked_from == [50, 15, 10, 5]
    assert reported == pytest.approx([reported[0]] * 4)
    assert reported[0] > 0.5


@every_model
def test_a_map_without_obstacles_is_refused(name: SensorModelName) -> None:
    with pytest.raises(ValueError, match="no occupied cell"):
        computed_model(Grid(np.zeros((3, 3), np.int8), 0.1, NO_OFFSET), SensorSettings(model=name))


@every_model
def test_arrays_of_another_map_are_refused(name: SensorModelName) -> None:
    kind, settings = model_class(name), SensorSettings(model=name)
    grid, rooms = (Grid(np.tile(plain_room(), (n, n)), CELL_M, NO_OFFSET) for n in (1, 9))
    arrays, others = (kind.arrays_of(of, settings) for of in (grid, rooms))
    for part in arrays:
        for wrong in (others[part], arrays[part].astype(np.float32)):
            with pytest.raises(ValueError, match="expected uint"):
                kind.from_arrays(grid, {**arrays, part: wrong}, settings)


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


@every_model
def test_two_lasers_weigh_as_much_as_each_alone_together(name: SensorModelName) -> None:
    room = plain_room()
    sensor = computed_model(
        Grid(room, CELL_M, NO_OFFSET), SensorSettings(model=name, max_beams=200)
    )
    poses = TRUTH + np.random.default_rng(1).normal(0.0, 0.3, (50, 3))
    first, second, merged = (sensor.beams(scan) for scan in both(room))
    assert merged.count == first.count + second.count
    alone = sensor.log_likelihood(poses, first) + sensor.log_likelihood(poses, second)
    np.testing.assert_allclose(sensor.log_likelihood(poses, merged), alone, rtol=1e-12)


def test_the_rays_of_each_laser_begin_at_its_mount() -> None:
    room = plain_room()
    field = model_of(room, SensorSettings(max_beams=200, visibility_beam_stride=1))
    poses = TRUTH + np.random.default_rng(1).normal(0.0, 0.3, (50, 3))
    first, second, merged = (field.beams(scan) for scan in both(room))
    alone = field.occluded(poses, first) + field.occluded(poses, second)
    np.testing.assert_array_equal(field.occluded(poses, merged), alone)
    assert alone.max() > 0.0
    # Rays of the rear laser that began at the front one would pass through the robot's place.
    wrong = replace(second, robot_from_laser=first.robot_from_laser)
    assert field.occluded(TRUTH[None], wrong)[0] >= field.occluded(TRUTH[None], second)[0]


@pytest.mark.parametrize(("most", "each"), [(60, 30), (1, 1)])
def test_lasers_share_the_beams_that_are_scored_and_each_has_one(most: int, each: int) -> None:
    merged = model_of(plain_room(), SensorSettings(max_beams=most)).beams(both(plain_room())[2])
    assert [len(laser.ranges) for laser in merged.lasers] == [each, each]


@every_model
def test_a_laser_that_sees_nothing_leaves_the_other_as_it_is(name: SensorModelName) -> None:
    room = plain_room()
    sensor = computed_model(
        Grid(room, CELL_M, NO_OFFSET), SensorSettings(model=name, max_beams=200)
    )
    front, rear, _ = both(room)
    blind = replace(rear, ranges=np.full(90, np.nan))
    first, merged = sensor.beams(front), sensor.beams(replace(front, others=(blind,)))
    np.testing.assert_array_equal(
        sensor.log_likelihood(TRUTH[None], merged), sensor.log_likelihood(TRUTH[None], first)
    )


def test_a_grid_is_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        Grid(plain_room(), CELL_M, NO_OFFSET).cells[0, 0] = 0
