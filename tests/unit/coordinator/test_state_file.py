import os
import resource
import stat
import threading
import time
from pathlib import Path

import pytest
from msgspec.structs import replace

from clustermcl.coordinator.state_file import MAX_FILE_BYTES, StateKeeper, files_of, read, write
from clustermcl.protocol.work import MAX_AHEAD_US, Checkpoint
from tests.unit.coordinator.test_coordinator import checkpoint_at

STATE = checkpoint_at((10.0, 5.0, 0.0))


def test_only_its_owner_can_read_a_state_file_and_no_part_of_an_earlier_one_is_left(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "new"
    folder.mkdir()
    part = files_of(folder, "robot")[0].with_suffix(".part")
    part.touch(0o600)
    part.write_bytes(b"half of it" * 100_000)
    write(folder, "robot", STATE, sync=True)
    assert read(folder, "robot") == STATE
    (file,) = folder.iterdir()
    assert file == files_of(folder, "robot")[0]
    assert stat.S_IMODE(file.stat().st_mode) == 0o600


def test_each_robot_has_its_own_state_file(tmp_path: Path) -> None:
    for serial, robot in enumerate(("a", "a/b")):
        write(tmp_path, robot, replace(STATE, serial=serial), sync=False)
    assert [kept and kept.serial for kept in (read(tmp_path, "a"), read(tmp_path, "a/b"))] == [0, 1]
    assert read(tmp_path, "c") is None
    assert read(tmp_path / "none", "a") is None


@pytest.mark.parametrize("cut_at", [0, 1, 40, 200, -2])
@pytest.mark.parametrize("sync", [True, False])
def test_a_truncated_file_is_logged_and_ignored(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, cut_at: int, sync: bool
) -> None:
    write(tmp_path, "robot", STATE, sync=sync)
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:cut_at])
    assert read(tmp_path, "robot") is None
    assert str(file) in caplog.text


@pytest.mark.parametrize(
    ("state", "named"),
    [
        (replace(STATE, state=b"rubbish"), "not a coordinator's state"),
        (replace(STATE, step=3), "a checkpoint of step 3 with another's state"),
        (replace(STATE, term=time.time_ns() // 1_000 + 2 * MAX_AHEAD_US), "ahead of the clock"),
    ],
)
def test_an_impossible_state_is_logged_and_ignored(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, state: Checkpoint, named: str
) -> None:
    write(tmp_path, "robot", state, sync=False)
    with files_of(tmp_path, "robot")[0].open("wb") as file:
        file.truncate(MAX_FILE_BYTES * 1_000)
    assert read(tmp_path, "robot") is None
    assert named in caplog.text
    assert f"larger than {MAX_FILE_BYTES} bytes" in caplog.text


def test_each_state_is_written_immediately_and_synced_once_a_second(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[float] = []
    monkeypatch.setattr(os, "fsync", lambda _: synced.append(time.monotonic()))
    keeper = StateKeeper(tmp_path, "robot", None)
    began_s = time.monotonic()
    with keeper.running():
        for serial in range(3, 15):
            keeper.offer(replace(STATE, serial=serial))
            while (kept := read(tmp_path, "robot")) is None or kept.serial != serial:
                assert time.monotonic() - began_s < 30.0
        while len(synced) < 4:  # the first, and the last of the burst a second later
            assert time.monotonic() - began_s < 30.0
        took_s = time.monotonic() - began_s
    assert took_s >= 1.0
    assert len(synced) <= 2 * (took_s + 2), "file and folder"


def test_a_state_without_clusters_does_not_replace_a_belief_on_disk(tmp_path: Path) -> None:
    """A coordinator that finds no worker searches; the next one may find them all."""
    write(tmp_path, "robot", STATE, sync=False)
    keeper = StateKeeper(tmp_path, "robot", STATE)
    with keeper.running():
        keeper.offer(replace(STATE, term=STATE.term + 1, founded=False))
    assert read(tmp_path, "robot") == STATE
    newer = replace(STATE, term=STATE.term + 1, serial=0)
    with (again := StateKeeper(tmp_path, "robot", STATE)).running():
        again.offer(newer)
    assert read(tmp_path, "robot") == newer


def test_the_first_state_of_a_term_is_in_the_file_before_it_is_published(tmp_path: Path) -> None:
    StateKeeper(tmp_path, "robot", None).offer(STATE)
    assert read(tmp_path, "robot") == STATE


def test_the_state_before_is_read_if_a_process_died_while_it_wrote_the_newest(
    tmp_path: Path,
) -> None:
    states = [replace(STATE, serial=serial) for serial in range(5)]
    for state in states:
        write(tmp_path, "robot", state, sync=state.serial == 0)
    on_disk, *recent = files_of(tmp_path, "robot")
    assert read(tmp_path, "robot") == states[4]
    for state, torn in zip((states[3], states[0]), recent, strict=True):
        torn.write_bytes(torn.read_bytes()[:-100] + bytes(500))
        assert read(tmp_path, "robot") == state
    on_disk.unlink()
    assert read(tmp_path, "robot") is None


def test_a_full_disk_is_logged_once_though_states_may_still_be_written_over(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "state-robot.part").mkdir()  # no new file can be written
    keeper = StateKeeper(tmp_path, "robot", None)
    for _ in range(3):
        keeper._write(tmp_path, STATE, sync=True)
        keeper._write(tmp_path, STATE, sync=False)
    assert caplog.text.count("cannot be kept") == 1
    assert read(tmp_path, "robot") == STATE


def test_a_shorter_state_leaves_nothing_of_a_longer_one_before(tmp_path: Path) -> None:
    longer = replace(STATE, term=STATE.term + 1, state=bytes(100_000))
    write(tmp_path, "robot", longer, sync=False)
    write(tmp_path, "robot", STATE, sync=False)
    assert read(tmp_path, "robot") == STATE


@pytest.mark.parametrize("sync", [True, False])
def test_a_full_disk_leaves_the_state_before_and_no_unfinished_file(
    tmp_path: Path, sync: bool
) -> None:
    write(tmp_path, "robot", STATE, sync=sync)
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, usual[1]))
    with pytest.raises(OSError, match="too large"):
        write(tmp_path, "robot", replace(STATE, state=bytes(100_000)), sync=sync)
    resource.setrlimit(resource.RLIMIT_FSIZE, usual)
    assert (read(tmp_path, "robot"), len(list(tmp_path.iterdir()))) == (STATE, 1)


def test_a_slow_disk_does_not_delay_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """It took 5 s; the process then ended with 1 and printed its stacks."""
    returned = threading.Event()
    monkeypatch.setattr("os.fsync", lambda _file: returned.wait(60.0))
    newest, begun_s = replace(STATE, serial=STATE.serial + 1), time.monotonic()
    with (keeper := StateKeeper(tmp_path, "robot", None)).running():
        keeper.offer(STATE)
        keeper.offer(newest)
    took_s = time.monotonic() - begun_s
    returned.set()
    assert took_s < 30.0
    assert read(tmp_path, "robot") == newest, "a later process finds it"
    assert "slow disk" in caplog.text
