from dataclasses import replace as with_fields

from clustermcl.evaluation.map_check.floors import floor_remarks
from clustermcl.evaluation.map_check.report import report_of
from clustermcl.protocol.floors import Floors, Link
from clustermcl.simulator.worlds.tower import tower

TOWER = tower().map


def test_floors_that_look_alike_are_named() -> None:
    report = report_of("tower", TOWER, laser_range_m=12.0, places=12, seed=0, agreement=None)
    said = " ".join(report.remarks)
    assert "on floor first look like places on floor second" in said
    assert "on floor ground look like" not in said
    assert "pieces" not in said


def test_a_link_that_ends_in_a_wall_is_named() -> None:
    (lift,) = TOWER.floors.links
    walled = Link("lift", {**lift.at, "first": (-1.05, 2.4)})
    moved = with_fields(TOWER, floors=Floors(TOWER.floors.floors, (walled,)))
    assert list(floor_remarks((), TOWER)) == []
    (remark,) = floor_remarks((), moved)
    assert remark.startswith("link lift ends in a wall on floor first: x -1.05 m, y 2.40 m")
