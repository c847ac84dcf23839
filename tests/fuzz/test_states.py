"""What a coordinator finds of the one before it, in a checkpoint or on disk."""

import contextlib
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.coordinator.checkpoint import CheckpointState, from_bytes, to_bytes
from clustermcl.coordinator.state_file import files_of, read, write
from clustermcl.protocol.work import Checkpoint
from tests.fuzz.any_message import values_of
from tests.fuzz.effort import cases
from tests.fuzz.mutations import damaged
from tests.unit.coordinator.living import Living, symmetric_room


@cases(0.02)
@given(damaged(values_of(CheckpointState).map(to_bytes)) | st.binary(max_size=200))
def test_a_checkpoints_state_is_read_or_refused(data: bytes) -> None:
    with contextlib.suppress(ValueError):
        from_bytes(data)


@cache
def real_checkpoints() -> list[Checkpoint]:
    """Of a search, and of clusters."""
    living = Living(symmetric_room())
    found = [living.drive_on(until).kept for until in (2, 7, 12, 14)]
    return [kept for kept in found if kept is not None]


def test_a_state_of_deep_nesting_is_refused() -> None:
    with pytest.raises(ValueError, match="not a coordinator's state"):
        from_bytes(b"\x81\xa1x" + b"\x91" * 100_000)


@cases(0.02)
@given(st.data())
def test_a_damaged_state_file_is_never_believed(folder: Path, data: st.DataObject) -> None:
    kept = data.draw(st.sampled_from(real_checkpoints()))
    write(folder, "robot", kept, sync=True)
    path, *_ = files_of(folder, "robot")
    path.write_bytes(data.draw(damaged(st.just(path.read_bytes()))))
    assert read(folder, "robot") in (None, kept)
