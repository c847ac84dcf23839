"""What a coordinator finds of the one before it, in a checkpoint or on disk."""

import contextlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from coordinator.checkpoint import CheckpointState, from_bytes, to_bytes
from coordinator.last_pose_files import file_of, read_all, write
from coordinator.pose.last_pose import LastPose
from tests.fuzz.any_message import values_of
from tests.fuzz.effort import cases
from tests.fuzz.mutations import Mutation, damaged, mutations

LAST = LastPose(
    map_digest="ab" * 32, stamp_ns=7, odom_from_robot=(1.0, 2.0, 3.0),
    map_from_robot=(4.0, 5.0, 6.0), covariance=(0.1,) * 9, probability=0.99,
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("state")


@cases(0.02)
@given(damaged(values_of(CheckpointState).map(to_bytes)) | st.binary(max_size=200))
def test_a_checkpoints_state_is_read_or_refused(data: bytes) -> None:
    with contextlib.suppress(ValueError):
        from_bytes(data)


def test_a_state_of_deep_nesting_is_refused() -> None:
    with pytest.raises(ValueError, match="not a coordinator's state"):
        from_bytes(b"\x81\xa1x" + b"\x91" * 100_000)


@cases(0.02)
@given(st.lists(mutations(), max_size=3))
def test_a_damaged_last_pose_is_never_believed(folder: Path, damages: list[Mutation]) -> None:
    write(folder, "robot", LAST)
    path = file_of(folder, "robot", LAST.map_digest)
    content = path.read_bytes()
    for damage in damages:
        content = damage(content)
    path.write_bytes(content)
    assert read_all(folder, "robot") in ({}, {LAST.map_digest: LAST})
