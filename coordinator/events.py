"""Events of a coordinator: plain facts, in the order in which they happened.

The loop creates them from messages, tokens and queries. They are recorded as MessagePack, and a
replay uses the same objects.
"""

from collections.abc import Iterable
from typing import TypeAlias, TypeVar

import msgspec

from coordinator.free_ground import FreeGround
from protocol.answers import Relocalize, SetPose
from protocol.codec import decode
from protocol.errors import MalformedMessageError
from protocol.steps import OdometryReading, Scan
from protocol.validity import assignment_problem
from protocol.work import Assignment, Checkpoint, OrderAnswer, Report, WorkerState

M = TypeVar("M")


class WorkerSnapshot(msgspec.Struct, frozen=True):
    """A worker's answer, decoded."""

    term: int
    holds: tuple[Assignment, ...] = ()
    reports: tuple[Report, ...] = ()
    terms: tuple[int, ...] = ()
    founded: int = 0


def told_by(state: WorkerState) -> WorkerSnapshot:
    """Decode the messages packed in a worker's answer; malformed ones are left out."""
    reports: list[Report] = _decoded(state.reports, Report)  # type: ignore[arg-type] # a union
    return WorkerSnapshot(
        term=state.term,
        holds=_possible(state.holds),
        reports=tuple(reports),
        terms=state.terms,
        founded=state.founded,
    )


def _possible(assignments: Iterable[Assignment]) -> tuple[Assignment, ...]:
    return tuple(held for held in assignments if assignment_problem(held) is None)


def _decoded(payloads: Iterable[bytes], kind: type[M]) -> list[M]:
    found = []
    for payload in payloads:
        try:
            found.append(decode(payload, kind))
        except MalformedMessageError:
            continue
    return found


class _Fact(msgspec.Struct, frozen=True, tag_field="event"):
    """Base class of all events; the tag is the class's name."""


class ScanArrived(_Fact, frozen=True):
    """The scan of a step was published."""

    scan: Scan


class HistoryArrived(_Fact, frozen=True):
    """Scans of the past, as the bridge answered; perhaps none."""

    scans: tuple[Scan, ...]


class OdometryArrived(_Fact, frozen=True):
    """The robot moved."""

    reading: OdometryReading


class ReportArrived(_Fact, frozen=True):
    """A worker's job took a step."""

    worker: str
    report: Report


class WorkerJoined(_Fact, frozen=True):
    """A worker's liveliness token appeared."""

    worker: str


class WorkerLeft(_Fact, frozen=True):
    """A worker's liveliness token is gone for certain."""

    worker: str


class WorkerReturned(_Fact, frozen=True):
    """A worker's token is back after the own link was lost; the worker may have been restarted."""

    worker: str


class WorkerToldState(_Fact, frozen=True):
    """A worker answered a new coordinator's question."""

    worker: str
    told: WorkerSnapshot


class OrderAnswered(_Fact, frozen=True):
    """A worker has accepted or refused an order."""

    worker: str
    answer: OrderAnswer


class TokenChanged(_Fact, frozen=True):
    """A liveliness token appeared or vanished; `Replica` decides what follows from it."""

    worker: str | None
    """None: a coordinator's."""
    alive: bool


class LinkChanged(_Fact, frozen=True):
    """Our own link to the router came up or was lost; `Replica` decides what follows from it."""

    up: bool


class CheckpointHeard(_Fact, frozen=True):
    """Another coordinator published its checkpoint."""

    checkpoint: Checkpoint


class LinkLost(_Fact, frozen=True):
    """Our own link is down: nothing is decided until it is back."""


class LinkBack(_Fact, frozen=True):
    """Our own link is back."""


class CommandArrived(_Fact, frozen=True):
    """A person has given the robot's pose, or started a search."""

    command: SetPose | Relocalize


class MapArrived(_Fact, frozen=True):
    """The bridge has answered with its map."""

    ground: FreeGround


class TimePassed(_Fact, frozen=True):
    """Nothing but time."""


Event: TypeAlias = (
    ScanArrived
    | HistoryArrived
    | OdometryArrived
    | ReportArrived
    | WorkerJoined
    | WorkerLeft
    | WorkerReturned
    | WorkerToldState
    | OrderAnswered
    | CheckpointHeard
    | LinkLost
    | LinkBack
    | CommandArrived
    | MapArrived
    | TimePassed
)
