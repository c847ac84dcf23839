"""What the recorder does when files fill up or a disk is slow or full, and what it leaves out."""

import logging
import os
import shutil
from pathlib import Path

import pytest
from msgspec.structs import replace

from clustermcl.coordinator.events import HistoryArrived, ReportArrived, ScanArrived, TimePassed
from clustermcl.coordinator.recorder import flight_recorder
from clustermcl.coordinator.recorder.flight_recorder import MAX_QUEUED
from clustermcl.coordinator.recorder.records import Happened, without_bulk
from clustermcl.coordinator.recorder.replay import CoordinatorActs
from clustermcl.coordinator.recorder.ring import FILES, Ring, files_in
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.work import TrackReport
from clustermcl.recordings import run_log
from tests.unit.coordinator.recorder.recorded import (
    STARTED,
    RecordedCoordinator,
    Recordings,
    events_in,
)
from tests.unit.coordinator.reports import cloud_at, scan, searched, tracked


def test_the_oldest_files_are_removed_when_the_ring_is_full(tmp_path: Path) -> None:
    max_bytes = 60_000
    recorded = RecordedCoordinator(STARTED, Ring(tmp_path, 7, max_bytes))
    for step in range(3_000):
        recorded.handle(ScanArrived(scan(step % 5)), step)
        assert sum(file.stat().st_size for file in files_in(tmp_path)) < max_bytes + 2_000
    names = [file.name for file in files_in(tmp_path)]
    assert len(names) > FILES // 2
    assert not names[0].endswith("-000000.mcap")
    assert recorded.recorder.lost == {}


def test_after_the_clock_was_set_back_the_old_files_are_removed_first(tmp_path: Path) -> None:
    recordings = Recordings(tmp_path, 60_000)
    for term in (2_000, 70, 900):  # a boot in 1970, then another
        recordings.make(replace(STARTED, term=term))
        recordings.made[-1].handle(TimePassed(), term)
    names = [f"{series:017d}-000000.mcap" for series in (2_000, 2_001, 2_002)]
    assert [file.name for file in files_in(tmp_path)] == names
    begun = [one.term for one in recordings.replay() if isinstance(one, CoordinatorActs)]
    assert begun == [2_000, 70, 900]
    files_in(tmp_path)[0].write_bytes(bytes(58_000))
    recordings.make(replace(STARTED, term=80))
    recordings.made[-1].handle(TimePassed(), 1)
    assert files_in(tmp_path)[0].name == names[1]


def test_a_slow_disk_causes_a_gap_whose_events_are_counted(tmp_path: Path) -> None:
    recordings = Recordings(tmp_path)
    recordings.make(STARTED)
    recorded = recordings.made[0]
    for now_ns in range(MAX_QUEUED + 500):  # no thread writes meanwhile
        recorded.recorder.handle(TimePassed(), now_ns)
    lost = recorded.recorder.lost[Cause.NOT_RECORDED]
    assert lost >= 500
    recorded.recorder.flush()
    for _ in range(3):
        recorded.handle(TimePassed(), 10_000)
    assert recorded.recorder.lost == {Cause.NOT_RECORDED: lost}
    gap = Happened("not recorded", f"{lost} events before {7:017d}-000001.mcap")
    assert gap in recordings.replay()
    assert len(events_in(tmp_path)) == MAX_QUEUED + 503 - lost


def test_a_folder_that_cannot_be_written_is_logged_once_and_tried_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "flight"
    folder.write_text("a file stands in the way")
    monkeypatch.setattr(flight_recorder, "RETRY_S", 0.0)
    recorded = RecordedCoordinator(STARTED, Ring(folder, 7, 60_000))
    with caplog.at_level(logging.WARNING):
        for now_ns in range(20):
            recorded.handle(TimePassed(), now_ns)
    assert recorded.term.begun, "the coordinator does its work"
    assert len(caplog.records) == 1
    assert "cannot write" in caplog.text
    assert recorded.recorder.lost == {Cause.NOT_RECORDED: 20}
    folder.unlink()
    recorded.handle(TimePassed(), 21)
    recorded.handle(TimePassed(), 22)
    assert recorded.recorder.lost[Cause.NOT_RECORDED] <= 21
    assert len(events_in(folder)) + recorded.recorder.lost[Cause.NOT_RECORDED] == 22


def test_a_full_disk_is_not_filled_with_empty_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: str, _flags: int) -> int:
        Path(path).touch()
        return os.open("/dev/full", os.O_WRONLY)

    monkeypatch.setattr(flight_recorder, "RETRY_S", 0.0)
    monkeypatch.setattr(run_log, "_private", full)
    recorded = RecordedCoordinator(STARTED, Ring(tmp_path, 7, 60_000))
    for now_ns in range(10):
        recorded.handle(TimePassed(), now_ns)
    assert recorded.recorder.lost == {Cause.NOT_RECORDED: 10}
    assert list(tmp_path.iterdir()) == []


def test_only_particles_and_beams_are_left_out_of_a_recording() -> None:
    where = (1.0, 2.0, 3.0)
    report = tracked("c0", 3, 0.1, where, snapshot=cloud_at(where, 3))
    small = without_bulk(ReportArrived("w", report))
    assert small.report.snapshot.map_from_robot.array().shape == (0, 3)
    assert small.report.snapshot.step == 3
    assert small.report.pose == report.pose
    found = without_bulk(ReportArrived("w", searched("s0.0", 3, {where: 0.5})))
    assert not isinstance(found.report, TrackReport)
    kept = found.report.places
    assert kept.particles.array().shape == (0, 3)
    assert kept.count.array().tolist() == [0]
    assert (kept.share.array().tolist(), kept.mean.array().tolist()) == ([0.5], [list(where)])
    past = without_bulk(HistoryArrived((scan(1), scan(2))))
    assert [one.step for one in past.scans] == [1, 2]
    assert all(one.ranges.array().shape == (0,) for one in past.scans)


def test_a_removed_folder_is_made_again_and_missing_events_are_counted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "flight"
    recordings = Recordings(folder)
    recorded = recordings.make(STARTED)
    recorder = recordings.made[0].recorder
    for now_ns in range(5):
        recorded.handle(TimePassed(), now_ns)
    shutil.rmtree(folder)
    with caplog.at_level(logging.WARNING):
        for now_ns in range(5, 15):
            recorded.handle(TimePassed(), now_ns)
    assert "was removed" in caplog.text
    lost = recorder.lost[Cause.NOT_RECORDED]
    assert len(events_in(folder)) + lost == 10, "at once, and what is not in it is counted"
    assert lost <= 2
    gap = Happened("not recorded", f"{5 + lost} events before {7:017d}-000001.mcap")
    assert gap in recordings.replay()
