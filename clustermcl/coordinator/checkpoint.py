"""The state that a coordinator transfers to its successor, without particles.

A `Checkpoint` carries the state as MessagePack that only coordinators read. So its form may change
with each `STATE_VERSION`; a state of another version is refused. Types limit every value; that the
values fit together is not checked: a file has a checksum, and access control lets only coordinators
publish a state.
"""

from typing import Annotated

import msgspec
from msgspec import Meta

from clustermcl.belief.commands import Commands
from clustermcl.belief.ensemble import Ensemble
from clustermcl.belief.part import FEW, Count, Text, handed_on
from clustermcl.coordinator.event_log import EventLog
from clustermcl.coordinator.jobs import Jobs
from clustermcl.coordinator.step_collector import StepCollector
from clustermcl.protocol.conversion import decoded
from clustermcl.protocol.work import Checkpoint

MAX_AGE_S = 1e9
STATE_VERSION = 14


class CheckpointState(msgspec.Struct, frozen=True):
    """The part of a coordinator's state from which another one continues."""

    version: int
    map_digest: Text
    ensemble: Ensemble
    jobs: Jobs
    collector: StepCollector
    commands: Commands
    event_log: EventLog
    missing: Annotated[tuple[Text, ...], FEW]
    """Jobs that did not report the last applied step in time."""
    age_s: Annotated[float, Meta(ge=-1.0, le=MAX_AGE_S)]
    """Age of a live robot's applied scan, otherwise of the newest data [s]; -1: there is none."""
    steps_applied: Count
    reports_missing: Count
    counters: Annotated[dict[Text, Count], FEW]


def to_bytes(state: CheckpointState) -> bytes:
    fields = {name: handed_on(getattr(state, name)) for name in state.__struct_fields__}
    return msgspec.msgpack.encode(fields)


def from_bytes(data: bytes) -> CheckpointState:
    """Decode a state.

    Raises:
        ValueError: the state cannot be read, has another version, or no coordinator wrote it.
    """
    try:
        state = decoded(data, CheckpointState)
        if state.version != STATE_VERSION:
            raise ValueError(f"state of version {state.version}, expected {STATE_VERSION}")
        if to_bytes(state) != data:
            raise ValueError("a state that no coordinator has written")
    except (msgspec.DecodeError, msgspec.ValidationError, RecursionError) as error:
        raise ValueError(f"not a coordinator's state of this version: {error}") from None
    return state


def state_in(checkpoint: Checkpoint) -> CheckpointState:
    """Return the state in a checkpoint.

    Raises:
        ValueError: as `from_bytes`, or the two belong to different steps.
    """
    state = from_bytes(checkpoint.state)
    applied = state.collector.applied
    if checkpoint.step != (applied.step if applied else -1):
        raise ValueError(f"a checkpoint of step {checkpoint.step} with another's state")
    return state
