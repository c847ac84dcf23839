"""The state of a coordinator as it is handed on: everything that decides, but for particles.

Each part of the coordinator says in its own module what of it is handed on; here these are put
together. The whole travels inside a `Checkpoint` as MessagePack that only coordinators read, so
its form may change with each `STATE_VERSION`; a state of another version is refused.
"""

import msgspec

from coordinator.belief.ensemble import EnsembleState
from coordinator.commands import CommandsState
from coordinator.membership.jobs import JobState
from coordinator.state_checks import (
    age_problem,
    collector_problem,
    commands_problem,
    counts_problem,
    ensemble_problem,
    items_problem,
    jobs_problem,
    texts_problem,
)
from coordinator.step_collector import StepCollectorState
from protocol.work import Checkpoint

STATE_VERSION = 5


class ImpossibleStateError(ValueError):
    """No coordinator can have been in this state."""


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
    """Of the applied scan when this was written, by a live robot's stamps, else of the newest data;
    -1: none."""
    age_known: bool
    """Whether who wrote it has heard data itself; else nobody knows how old it is."""
    steps_applied: int
    reports_missing: int
    counters: dict[str, int]


def to_bytes(state: CheckpointState) -> bytes:
    """The state as it travels."""
    return msgspec.msgpack.encode(state)


def from_bytes(data: bytes) -> CheckpointState:
    """The state as it was before it travelled.

    Raises:
        ImpossibleStateError: numbers in it cannot be, or contradict each other.
        ValueError: it cannot be read, or is of another version.
    """
    try:
        version = _VERSIONS.decode(data).version
        if version != STATE_VERSION:
            raise ValueError(f"state of version {version}, expected {STATE_VERSION}")
        state = _STATES.decode(data)
    except (msgspec.DecodeError, msgspec.ValidationError, RecursionError) as error:
        raise ValueError(f"not a coordinator's state: {error}") from None
    if problem := _problem(state):
        raise ImpossibleStateError(problem)
    return state


def state_in(checkpoint: Checkpoint) -> CheckpointState:
    """The state in a checkpoint, which is of the step that the checkpoint says.

    Raises:
        ValueError: as `from_bytes`.
    """
    state = from_bytes(checkpoint.state)
    applied = state.collector.applied
    if checkpoint.step != (applied.step if applied else -1):
        raise ImpossibleStateError(f"a checkpoint of step {checkpoint.step} with another's state")
    return state


def _problem(state: CheckpointState) -> str | None:
    """Why the state is impossible; None where it can have been."""
    counts = (state.steps_applied, state.reports_missing, *state.counters.values())
    return (
        items_problem(state.jobs)
        or collector_problem(state.collector)
        or ensemble_problem(state.ensemble, state.collector.applied)
        or jobs_problem(state.jobs, state.ensemble, state.collector.applied)
        or commands_problem(state.commands)
        or age_problem(state.age_s)
        or counts_problem(counts)
        or texts_problem((state.map_digest, *state.missing, *state.counters))
    )


def arrival(checkpoint: Checkpoint, heard_ns: int) -> tuple[int, int] | None:
    """The stamp of the applied scan, and when it arrived, by the clock of `heard_ns` [ns].

    None where the state tells of no live robot's scan, or cannot be read.
    """
    try:
        state = _AGES.decode(checkpoint.state)
    except (msgspec.DecodeError, msgspec.ValidationError, RecursionError):
        return None
    applied = state.collector.applied
    is_told = state.version == STATE_VERSION and state.age_known and not age_problem(state.age_s)
    if not is_told or applied is None or not applied.live:
        return None
    return applied.stamp_ns, heard_ns - int(state.age_s * 1e9)


class _Version(msgspec.Struct, frozen=True):
    version: int


class _Applied(msgspec.Struct, frozen=True):
    stamp_ns: int
    live: bool


class _Collector(msgspec.Struct, frozen=True):
    applied: _Applied | None


class _Age(_Version, frozen=True):
    collector: _Collector
    age_s: float
    age_known: bool


# Made once, before there are threads: msgspec learns a type when it is first decoded, and crashes
# where another thread, as the flight recorder's, decodes it meanwhile.
_VERSIONS = msgspec.msgpack.Decoder(_Version)
_AGES = msgspec.msgpack.Decoder(_Age)
_STATES = msgspec.msgpack.Decoder(CheckpointState)
