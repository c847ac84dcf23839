import errno
import math
import os
from pathlib import Path

import msgspec
import pytest

from coordinator import last_pose_files
from coordinator.pose.last_pose import LastPose
from coordinator.pose_keeper import PoseKeeper
from protocol.answers import Belief, Hypothesis, State
from tests.unit.coordinator.reports import NO_SPREAD, scan

POSE = LastPose(
    map_digest="0123456789abcdef0123",
    stamp_ns=7,
    odom_from_robot=(3.0, 0.0, 0.0),
    map_from_robot=(10.0, 5.0, math.pi / 2),
    covariance=NO_SPREAD,
    probability=0.97,
)


def test_what_was_written_is_read(tmp_path: Path) -> None:
    last_pose_files.write(tmp_path / "new", "robot", POSE)
    assert last_pose_files.read_all(tmp_path / "new", "robot") == {POSE.map_digest: POSE}
    assert len(list((tmp_path / "new").iterdir())) == 1, "no part of a file is left"


def test_a_robot_reads_its_own_poses_only_and_keeps_one_for_each_map(tmp_path: Path) -> None:
    other = msgspec.structs.replace(POSE, map_digest="ffff" * 5)
    for robot, pose in (("a", POSE), ("a", other), ("a/b", POSE)):
        last_pose_files.write(tmp_path, robot, pose)
    assert set(last_pose_files.read_all(tmp_path, "a")) == {POSE.map_digest, other.map_digest}
    assert set(last_pose_files.read_all(tmp_path, "a/b")) == {POSE.map_digest}
    assert last_pose_files.read_all(tmp_path, "c") == {}


def test_a_folder_that_is_not_there_holds_no_pose(tmp_path: Path) -> None:
    assert last_pose_files.read_all(tmp_path / "none", "robot") == {}


@pytest.mark.parametrize("cut_at", [0, 1, 40, 200, -2])
def test_a_file_cut_off_is_named_and_ignored(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, cut_at: int
) -> None:
    last_pose_files.write(tmp_path, "robot", POSE)
    file = last_pose_files.file_of(tmp_path, "robot", POSE.map_digest)
    file.write_bytes(file.read_bytes()[:cut_at])
    assert last_pose_files.read_all(tmp_path, "robot") == {}
    assert str(file) in caplog.text


def test_a_flipped_bit_is_noticed_wherever_it_is(tmp_path: Path) -> None:
    last_pose_files.write(tmp_path, "robot", POSE)
    file = last_pose_files.file_of(tmp_path, "robot", POSE.map_digest)
    whole = file.read_bytes()
    for at in range(len(whole)):
        broken = bytearray(whole)
        broken[at] ^= 1 << (at % 8)
        file.write_bytes(broken)
        assert last_pose_files.read_all(tmp_path, "robot").get(POSE.map_digest, POSE) == POSE


def test_a_broken_file_gives_way_to_the_next_pose(tmp_path: Path) -> None:
    last_pose_files.file_of(tmp_path, "robot", POSE.map_digest).write_bytes(b"\x00" * 30_000)
    assert last_pose_files.read_all(tmp_path, "robot") == {}
    last_pose_files.write(tmp_path, "robot", POSE)
    assert last_pose_files.read_all(tmp_path, "robot") == {POSE.map_digest: POSE}


def test_the_keeper_writes_the_first_pose_at_once_and_the_newest_at_the_end(
    tmp_path: Path,
) -> None:
    keeper = PoseKeeper(tmp_path, "robot", every_s=3600.0)
    with keeper.running():
        for stamp_ns in range(5):
            keeper.offer(msgspec.structs.replace(POSE, stamp_ns=stamp_ns))
    assert last_pose_files.read_all(tmp_path, "robot")[POSE.map_digest].stamp_ns == 4


def test_a_disk_that_cannot_be_written_is_told_once_and_harms_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    occupied = tmp_path / "file"
    occupied.write_text("not a folder")
    keeper = PoseKeeper(occupied, "robot", every_s=0.001)
    with keeper.running():
        for _ in range(3):
            keeper.offer(POSE)
    assert caplog.text.count("cannot be kept") == 1


def test_what_a_killed_process_left_is_removed_at_the_next_start(tmp_path: Path) -> None:
    last_pose_files.write(tmp_path, "robot", POSE)
    old, new, others = (
        tmp_path / f"last-pose-{name}.part" for name in ("robot-0123a", "robot-0123b", "r2-0123")
    )
    for part in (old, new, others):
        part.write_bytes(b"half of i")
    for part in (old, others):
        os.utime(part, (0.0, 0.0))
    with PoseKeeper(tmp_path, "robot", every_s=3600.0).running():
        pass
    assert not old.exists()
    assert new.exists(), "another coordinator may be writing it"
    assert others.exists(), "another robot's"
    assert last_pose_files.read_all(tmp_path, "robot") == {POSE.map_digest: POSE}


def test_a_full_disk_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_number: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        last_pose_files.write(tmp_path, "robot", POSE)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("state", ["localized", "ambiguous", "lost"])
def test_a_belief_is_kept_only_where_it_is_sure(state: State) -> None:
    best = Hypothesis(
        cluster=3, probability=0.97, log_probability=math.log(0.97), mean=POSE.map_from_robot,
        covariance=NO_SPREAD, effective_sample_size=60.0, age_steps=9,
    )  # fmt: skip
    belief = Belief(
        sender="c", step=9, stamp_ns=7, odom_from_robot=(3.0, 0.0, 0.0), state=state,
        hypotheses=(best,), searching=False, missing=(),
    )  # fmt: skip
    kept = LastPose.of(belief, POSE.map_digest)
    assert kept == (POSE if state == "localized" else None)


def test_odometry_that_goes_on_carries_the_place_on() -> None:
    prior = POSE.as_prior_at(scan(9, x_m=4.0), 0.1)
    assert prior.map_from_robot == pytest.approx((10.0, 6.0, math.pi / 2))
    assert prior.odom_from_robot == (4.0, 0.0, 0.0)
    assert prior.covariance[0] > POSE.covariance[0]


def test_odometry_that_starts_anew_leaves_the_robot_where_it_stood() -> None:
    prior = POSE.as_prior_at(scan(0, x_m=0.1), 0.1)
    assert prior.map_from_robot == pytest.approx(POSE.map_from_robot)
