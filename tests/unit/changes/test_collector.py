import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from clustermcl.changes import collector as collecting
from clustermcl.changes.collector import ChangeCollector
from clustermcl.protocol.changes import GONE, MOVED, NEW
from clustermcl.recordings.maps.grid_map import coarse
from tests.unit.changes.drives import ASIDE, CHAIR, OLD, SHELF, TRUE, Drive, room, scan_at
from tests.unit.evaluation.places import place


def marked(drive: Drive, kind: int) -> np.ndarray:
    changes = drive.collector.changes("test")
    cells = changes.cells.array()
    mask = np.zeros((changes.rows, changes.cols), bool)
    mask.flat[cells[cells[:, 1] == kind, 0]] = True
    return mask


def is_coarse(box: tuple[slice, slice]) -> np.ndarray:
    cells = np.zeros(OLD.cells.shape, np.int8)
    cells[box] = 1
    return coarse(cells, 2) > 0


def test_a_missing_shelf_is_gone_and_a_chair_is_new_and_nothing_else() -> None:
    drive = Drive().steps(60)
    assert (marked(drive, GONE) == is_coarse(SHELF)).all()
    new, chair = marked(drive, NEW), is_coarse(CHAIR)
    assert np.count_nonzero(new & chair) >= 3  # its sides that the robot has seen
    assert not (new & ~_around(chair)).any()
    changes = drive.collector.changes("test")
    assert changes.area_m2[GONE] == pytest.approx(0.2)
    assert changes.seen_share > 0.9
    since_s, seen_s = changes.times_s.array().T
    assert (since_s < seen_s).all()
    assert seen_s.max() == pytest.approx(59.0)


def _around(mask: np.ndarray) -> np.ndarray:
    wide = np.pad(mask, 1)
    rows, cols = mask.shape
    return np.logical_or.reduce([wide[i : i + rows, j : j + cols] for i, j in np.ndindex(3, 3)])


def test_a_robot_that_stands_or_moves_a_little_changes_nothing() -> None:
    drive = Drive()
    for step in range(60):
        pose = (1.0 + 0.4 * (step % 2), 0.4, 0.0)
        scan = scan_at(TRUE, pose, step, OLD.digest)
        drive.collector.on_step(scan, "localized", (place(1.0, pose),))
    assert drive.kinds() == {}


def test_people_are_no_change() -> None:
    drive = Drive(TRUE).steps(200, TRUE, people=0.15)
    seen = np.count_nonzero(drive.collector.seen_min)
    assert sum(drive.kinds().values()) <= 0.002 * seen


def test_only_a_localized_robot_collects() -> None:
    drive = Drive()
    for step, (x, y) in enumerate(zip(np.arange(0.5, 5.0, 0.25), [0.4] * 18, strict=True)):
        scan = scan_at(TRUE, (x, y, 0.0), step, OLD.digest)
        for state in ("ambiguous", "lost", "searching"):
            drive.collector.on_step(scan, state, (place(1.0, (x, y, 0.0)),))
        other_map = replace(scan, map_digest="other")
        drive.collector.on_step(other_map, "localized", (place(1.0, (x, y, 0.0)),))
    assert not len(drive.collector.records)
    assert not drive.collector.seen_min.any()


def test_what_was_seen_before_is_collected_once_the_robot_is_localized() -> None:
    drive = Drive().steps(40, state="ambiguous")
    assert not len(drive.collector.records)
    assert drive.steps(1).kinds() == Drive().steps(41).kinds()


def test_a_place_that_was_wrong_while_and_after_it_was_ambiguous_leaves_nothing() -> None:
    drive = Drive().steps(200, state="ambiguous").steps(100, off=ASIDE, cluster=2)
    assert sum(drive.kinds().values()) > 20
    assert drive.steps(1).kinds() == {}
    assert (drive.steps(60).kinds()[GONE], drive.kinds()[NEW]) == (20, 7)


@pytest.mark.parametrize("wrong_steps", [60, 100])
def test_what_a_wrong_robot_has_collected_is_taken_back(wrong_steps: int) -> None:
    drive = Drive().steps(2 * collecting.TRUSTED_STEPS + 1)
    right = drive.collector.changes("test").cells.array()[:, :2]
    drive.steps(wrong_steps, off=ASIDE, cluster=1)
    assert len(drive.collector.changes("test").cells.array()) > len(right)
    drive.steps(1, cluster=2)
    after = drive.collector.changes("test").cells.array()[:, :2]
    np.testing.assert_array_equal(after, right)
    seen_min = drive.collector.seen_min
    trusted_min = collecting.minute_of(collecting.TRUSTED_STEPS * 10**9)  # a step is a second
    now = collecting.minute_of(drive.collector.stamp_ns)
    assert ((seen_min < trusted_min) | (seen_min == now)).all()


def test_a_robot_that_was_wrong_from_the_start_leaves_nothing() -> None:
    drive = Drive().steps(60, off=ASIDE)
    assert drive.kinds()
    assert set(np.unique(drive.collector.seen_min)) == {0, 1}
    assert drive.steps(1, cluster=2).kinds() == {}
    assert set(np.unique(drive.collector.seen_min)) == {0, 2}  # of the last scan, a minute later


def test_a_place_that_another_cluster_continues_is_no_error() -> None:
    drive = Drive().steps(60)
    kinds = drive.kinds()
    drive.steps(1, off=(0.2, 0.1), cluster=2)
    assert drive.kinds() == kinds


def test_a_door_that_opens_and_closes_is_moving_after_three_changes() -> None:
    closed, drive = room(SHELF, CHAIR), Drive()
    for number, (true, kind) in enumerate(((closed, NEW), (OLD, None), (closed, MOVED))):
        drive.steps(80, true)
        assert marked_kinds(drive, is_coarse(CHAIR)) == {kind} - {None}, number
    drive.steps(80, OLD)
    assert marked_kinds(drive, is_coarse(CHAIR)) == {MOVED}


def marked_kinds(drive: Drive, where: np.ndarray) -> set[int]:
    cells = drive.collector.changes("test").cells.array()
    return set(cells[where.flat[cells[:, 0]], 1].tolist())


def test_evidence_of_last_month_is_forgotten() -> None:
    drive = Drive()
    for step, x in enumerate((0.5, 1.1, 1.7, 2.3)):
        scan = scan_at(TRUE, (x, 0.4, 0.0), step, OLD.digest)
        scan = replace(scan, stamp_ns=step * 30 * 86_400 * 10**9)
        drive.collector.on_step(scan, "localized", (place(1.0, (x, 0.4, 0.0)),))
    assert drive.kinds() == {}


def test_records_are_bounded_and_keep_what_has_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = Drive().steps(60)
    changed = drive.kinds()
    monkeypatch.setattr(collecting, "MOST_RECORDS", len(drive.collector.records) + 90)
    for _ in range(120):  # without the limit: 101 more
        drive.steps(1, people=0.25)
        assert len(drive.collector.records) <= collecting.MOST_RECORDS
    assert drive.kinds()[GONE] + drive.kinds()[MOVED] >= changed[GONE]


def test_cells_of_a_large_map_are_larger(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collecting, "MOST_CELLS", 1_000)
    changes = ChangeCollector(OLD).changes("test")
    assert changes.rows * changes.cols <= 1_000
    assert changes.cell_m == pytest.approx(0.2)


@given(
    x=st.floats(-1e7, 1e7), y=st.floats(-1e7, 1e7), heading=st.floats(-1e3, 1e3),
    ranges=st.lists(st.floats(width=32), min_size=1, max_size=20),
    stamp_s=st.integers(-(2**32), 2**32),
)  # fmt: skip
def test_any_scan_at_any_pose_is_taken(
    x: float, y: float, heading: float, ranges: list[float], stamp_s: int
) -> None:
    drive, pose = Drive(), (x, y, heading)
    scan = scan_at(TRUE, (1.0, 0.4, 0.0), 0, OLD.digest)
    blob = scan.ranges.of(np.array(ranges), "float32")
    scan = replace(scan, ranges=blob, stamp_ns=stamp_s * 10**9, robot_from_laser=pose)
    for _ in range(2):
        drive.collector.on_step(scan, "localized", (place(1.0, pose),))
    assert drive.kinds() == {}
    assert not (drive.collector._codes & 0xFFF0).any()  # no mark of a scan stays
