"""What a coordinator finds of the one before it, in a checkpoint or on disk."""

import contextlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.coordinator import events
from clustermcl.coordinator.checkpoint import CheckpointState, from_bytes, to_bytes
from clustermcl.coordinator.instructions import (
    Instruction,
    SendOrder,
)
from clustermcl.coordinator.state_file import files_of, read, write
from clustermcl.protocol.answers import Belief, SetPose
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.work import Checkpoint, WorkerState, WorkOrder
from tests.fuzz.any_message import values_of
from tests.fuzz.effort import cases
from tests.fuzz.mutations import Mutation, damaged, mutations
from tests.unit.coordinator.living import SETTINGS, Living, scan_of, symmetric_room
from tests.unit.coordinator.reports import started


@cases(0.02)
@given(damaged(values_of(CheckpointState).map(to_bytes)) | st.binary(max_size=200))
def test_a_checkpoints_state_is_read_or_refused(data: bytes) -> None:
    with contextlib.suppress(ValueError):
        from_bytes(data)


# --- a real state, in which numbers were changed --------------------------------------------------

SECOND = 1_000_000_000


@cache
def real_checkpoints() -> list[Checkpoint]:
    """With a search, clusters with and without a worker, and a command."""
    living = Living(symmetric_room())
    found = []
    for step in range(14):
        living.drive(step)
        if step in (1, 6, 11, 13):
            assert living.kept is not None
            found.append(living.kept)
    living.command(given_pose("1"))
    for name in list(living.workers)[1:]:
        living.kill_worker(name)
    last = living.coordinator
    assert last is not None
    done = last.handle(events.WorkerChanged("new", "joined"), 20 * SECOND)
    return [*found, *(do for do in done if isinstance(do, Checkpoint))]


def given_pose(command_id: str) -> SetPose:
    return SetPose(sender="person", command_id=command_id, pose=(2.0, 2.0, 0.5))


def carried_on(checkpoint: Checkpoint) -> list[Instruction]:
    """What a coordinator does that finds the checkpoint, and then lives for some steps."""
    begun = started(filter_settings=SETTINGS, term=1, known=checkpoint)
    coordinator = begun.coordinator()
    nothing = WorkerState(sender="w", term=0, holds=())
    scans = [events.ScanArrived(scan_of(step)) for step in (12, 13, 14, 15)]
    reported = (
        *(
            events.WorkerChanged("w0", "joined"),
            events.WorkerStateArrived("w0", nothing),
            events.TimePassed(),
            *scans,
        ),
        *(events.CommandArrived(given_pose("2")), events.TimePassed()),
    )
    done = []
    for number, event in enumerate(reported):
        now_ns = (1 + 3 * number) * SECOND
        done += coordinator.handle(event, now_ns)
        for answer in (coordinator.pose, coordinator.hypotheses):
            encode(answer(now_ns))
        encode(coordinator.status(now_ns, {}))
    assert coordinator.term.begun
    return done


def assert_all_can_be_read(done: Iterable[Instruction]) -> None:
    for do in done:
        match do:
            case Belief():
                reported = decode(encode(do), Belief)
                here = sum(one.probability for one in reported.hypotheses)
                assert here + reported.elsewhere_probability == pytest.approx(1.0)
            case SendOrder(order=order):
                decode(encode(order), WorkOrder)
            case Checkpoint():
                from_bytes(decode(encode(do), Checkpoint).state)


def test_a_state_of_a_real_run_is_continued() -> None:
    for checkpoint in real_checkpoints():
        done = carried_on(checkpoint)
        assert_all_can_be_read(done)
        beliefs = [do for do in done if isinstance(do, Belief)]
        assert beliefs[0].step == checkpoint.step


def test_a_state_of_deep_nesting_is_refused() -> None:
    with pytest.raises(ValueError, match="not a coordinator's state"):
        from_bytes(b"\x81\xa1x" + b"\x91" * 100_000)


@cases(0.02)
@given(st.sampled_from(range(4)), st.lists(mutations(), max_size=3))
def test_a_damaged_state_file_is_never_believed(
    folder: Path, which: int, damages: list[Mutation]
) -> None:
    kept = real_checkpoints()[which]
    write(folder, "robot", kept, sync=True)
    path, *_ = files_of(folder, "robot")
    content = path.read_bytes()
    for damage in damages:
        content = damage(content)
    path.write_bytes(content)
    assert read(folder, "robot") in (None, kept)
