"""Which places of our worlds look alike is known: they were drawn so."""

import math
from dataclasses import replace as with_fields

import numpy as np
import pytest

from benchmarks.experiments.observability import turned_copies
from benchmarks.worlds import world
from clustermcl.commands.check import lines_of
from clustermcl.evaluation.map_check.look_alikes import LookAlikeSearch
from clustermcl.evaluation.map_check.report import MapReport, floor_remarks, ground_of, report_of
from clustermcl.filter.poses import heading_distance
from clustermcl.protocol.floors import Floors, Link
from clustermcl.protocol.pose_arrays import pose_tuple
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.simulator.worlds.tower import tower


def report_on(plan: GridMap, places: int, laser_range_m: float = 12.0) -> MapReport:
    return report_of(
        "plan", plan, laser_range_m=laser_range_m, places=places, seed=1, agreement=None
    )


def test_every_place_of_the_cross_looks_like_its_three_images() -> None:
    search = LookAlikeSearch(world("cross").map, 12.0, np.random.default_rng(3))
    for _ in range(5):
        view = search.random_view()
        found = search.places_like(view)
        assert len(found) == 4
        for image in turned_copies(pose_tuple(view.map_from_robot), 4, (0.0, 0.0)):
            near = np.hypot(*(found[:, :2] - image[:2]).T) < 0.1
            near &= heading_distance(found[:, 2], image[2]) < math.radians(2.0)
            assert np.count_nonzero(near) == 1


def test_a_hall_with_a_difference_everywhere_has_no_look_alikes() -> None:
    report = report_on(world("hall").map, 8)
    assert [place.look_alikes for place in report.places] == [()] * 8
    assert report.remarks == ()


def test_a_symmetric_hall_is_reported() -> None:
    report = report_on(world("hall_symmetric").map, 8)
    (alike,) = report.remarks
    assert alike.startswith("8 of 8 places look like others")
    assert [len(place.look_alikes) for place in report.places] == [1] * 8


def test_a_short_sighted_laser_is_reported() -> None:
    report = report_on(world("hall").map, 4, laser_range_m=0.5)
    assert report.remarks[0].startswith("from 4 of 4 places most beams hit nothing within 0.5 m")


def test_pieces_and_the_open_rim_of_the_ground_are_measured() -> None:
    cells = np.full((10, 30), 1, np.int8)
    cells[2:8, 2:12] = 0  # 60 cells, walled in
    cells[2:8, 15:17] = 0  # 12 cells next to them
    cells[3:5, 17] = -1  # with a window of two cells
    cells[0, 29] = 0  # a speck, on the rim of the map
    ground = ground_of(GridMap(cells, 0.5, (0.0, 0.0, 0.0)))
    assert (ground.rows, ground.cols, ground.width_m, ground.height_m) == (10, 30, 15.0, 5.0)
    assert ground.free_m2 == pytest.approx(73 * 0.25)
    assert ground.pieces == 2
    assert ground.largest_piece_share == pytest.approx(60 / 73)
    around = 2 * (6 + 10) + 2 * (6 + 2) + 4  # of the rooms, and of the speck
    assert ground.open_rim_share == pytest.approx((2 + 2) / around)  # off the map is unknown
    assert ground.unknown_share == pytest.approx(2 / 300)


TOWER = tower().map


def test_floors_that_look_alike_are_named() -> None:
    report = report_of("tower", TOWER, laser_range_m=12.0, places=12, seed=0, agreement=None)
    said = " ".join(report.remarks)
    assert "on floor first look like places on floor second" in said
    assert "on floor ground look like" not in said
    assert "pieces" not in said
    shown = [line.split() for line in lines_of(report, TOWER.floors) if " deg" in line]
    assert {floor for _, floor, *_ in shown} == {"first", "second"}
    assert all(abs(float(x_m)) < 13.0 for _, _, _, x_m, *_ in shown), "on the floor, not the atlas"


def test_a_link_that_ends_in_a_wall_is_named() -> None:
    (lift,) = TOWER.floors.links
    walled = Link("lift", {**lift.at, "first": (-1.05, 2.4)})
    moved = with_fields(TOWER, floors=Floors(TOWER.floors.floors, (walled,)))
    assert list(floor_remarks((), TOWER)) == []
    (remark,) = floor_remarks((), moved)
    assert remark.startswith("link lift ends in a wall on floor first: x -1.05 m, y 2.40 m")
