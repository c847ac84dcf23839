"""The state of a coordinator as it is handed on: everything that decides, but for particles.

Each part of the coordinator says in its own module what of it is handed on; here these are put
together. The whole travels inside a `Checkpoint` as MessagePack that only coordinators read, so
its form may change with each `STATE_VERSION`; a state of another version is refused.
"""

import math

import msgspec

from coordinator.belief.ensemble import EnsembleState
from coordinator.commands import CommandsState
from coordinator.membership.jobs import JobState
from coordinator.step_collector import StepCollectorState

STATE_VERSION = 2


class CheckpointState(msgspec.Struct, frozen=True):
    """Everything that a coordinator would need to carry on."""

    version: int
    map_digest: str
    ensemble: EnsembleState
    jobs: tuple[JobState, ...]
    collector: StepCollectorState
    commands: CommandsState
    missing: tuple[str, ...]
    """Jobs that did not report the last applied step in time."""
    age_s: float
    """Of the newest data when this was written; -1: none."""
    steps_applied: int
    reports_missing: int
    counters: dict[str, int]


def to_bytes(state: CheckpointState) -> bytes:
    """The state as it travels."""
    return msgspec.msgpack.encode(state)


def from_bytes(data: bytes) -> CheckpointState:
    """The state in a checkpoint.

    Raises:
        ValueError: it cannot be read, contradicts itself, or is of another version.
    """
    try:
        version = msgspec.msgpack.decode(data, type=_Version).version
        if version != STATE_VERSION:
            raise ValueError(f"state of version {version}, expected {STATE_VERSION}")
        state = msgspec.msgpack.decode(data, type=CheckpointState)
    except (msgspec.DecodeError, msgspec.ValidationError, RecursionError) as error:
        raise ValueError(f"not a coordinator's state: {error}") from None
    clusters = {cluster.job_id for cluster in state.ensemble.clusters}
    held = {job.job_id for job in state.jobs if job.job is None}
    if held - clusters or (held and state.collector.applied is None):
        raise ValueError("a job whose particles a worker holds has no cluster")
    if any(math.isnan(cluster.log_probability) for cluster in state.ensemble.clusters):
        raise ValueError("a cluster's probability is not a number")
    return state


class _Version(msgspec.Struct, frozen=True):
    version: int
