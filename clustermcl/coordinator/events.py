"""Events of a coordinator: plain facts, in the order in which they happened.

The loop creates them from messages, tokens and queries. They are recorded as MessagePack, and a
replay uses the same objects.
"""

from typing import Literal, TypeAlias

import msgspec

from clustermcl.belief.free_ground import FreeGround
from clustermcl.protocol.answers import Relocalize, SetPose
from clustermcl.protocol.steps import OdometryReading, Scan
from clustermcl.protocol.work import Checkpoint, OrderAnswer, Report, WorkerState


class _Fact(msgspec.Struct, frozen=True, tag_field="event"):
    """Base class of all events; the tag is the class's name."""


class ScanArrived(_Fact, frozen=True):
    """The bridge published the scan of a step."""

    scan: Scan


class HistoryArrived(_Fact, frozen=True):
    """The bridge answered with earlier scans; the answer may be empty."""

    scans: tuple[Scan, ...]


class OdometryArrived(_Fact, frozen=True):
    """The bridge published odometry."""

    reading: OdometryReading


class ReportArrived(_Fact, frozen=True):
    """A worker reported a step of a job."""

    worker: str
    report: Report


class WorkerChanged(_Fact, frozen=True):
    """A worker's token appeared, is gone for certain, or reappeared after a lost link."""

    worker: str
    how: Literal["joined", "left", "returned"]


class WorkerStateArrived(_Fact, frozen=True):
    """A worker answered a new coordinator's query."""

    worker: str
    state: WorkerState


class OrderAnswered(_Fact, frozen=True):
    """A worker accepted or refused an order."""

    worker: str
    answer: OrderAnswer


class TokenChanged(_Fact, frozen=True):
    """A liveliness token appeared or vanished; `Replica` decides what follows."""

    worker: str | None
    """Name of the worker; None: the token of a coordinator."""
    alive: bool


class LinkChanged(_Fact, frozen=True):
    """The link was lost or restored, or a pause left it uncertain who leads: decide nothing."""

    up: bool


class CheckpointArrived(_Fact, frozen=True):
    """Another coordinator published its checkpoint."""

    checkpoint: Checkpoint


class CommandArrived(_Fact, frozen=True):
    """A client gave the robot's pose, or started a search."""

    command: SetPose | Relocalize


class MapArrived(_Fact, frozen=True):
    """The bridge answered with its map."""

    ground: FreeGround


class TimePassed(_Fact, frozen=True):
    """Time passed without another event."""


Event: TypeAlias = (
    ScanArrived
    | HistoryArrived
    | OdometryArrived
    | ReportArrived
    | WorkerChanged
    | WorkerStateArrived
    | OrderAnswered
    | CheckpointArrived
    | LinkChanged
    | CommandArrived
    | MapArrived
    | TimePassed
)
