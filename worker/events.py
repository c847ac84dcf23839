"""What a worker can be told: plain facts, so that a test is a list of them."""

from dataclasses import dataclass
from typing import Any, TypeAlias

from particle_filter.sensor_model import SensorModel
from protocol.errors import MalformedMessageError
from protocol.steps import MapMessage, Scan
from protocol.work import Checkpoint, TakeOver, WorkOrder
from worker.job_table import MissingScans


@dataclass(frozen=True)
class ScanArrived:
    """The bridge has made a step."""

    scan: Scan
    dropped: int = 0
    """Scans that this process has had no room for, since its start."""


@dataclass(frozen=True)
class CheckpointHeard:
    """A coordinator has published its state: it has begun, and lives."""

    checkpoint: Checkpoint


@dataclass(frozen=True)
class OrderAsked:
    """A coordinator gives an order and waits for the answer."""

    question: Any
    """Handle of the query, for its `Answer`."""
    order: WorkOrder


@dataclass(frozen=True)
class BrokenOrderAsked:
    """Somebody waits for the answer to an order that cannot be read."""

    question: Any
    error: MalformedMessageError


@dataclass(frozen=True)
class StateAsked:
    """Somebody wants to know what this worker does."""

    question: Any
    take_over: TakeOver | None = None
    """Of a new coordinator, which needs all that it takes to carry on."""


@dataclass(frozen=True)
class MapArrived:
    """The bridge has answered `FetchMap`."""

    message: MapMessage


@dataclass(frozen=True)
class MapFailed:
    """`FetchMap` or `BuildModel` has come to nothing."""

    error: Exception
    """A `ClusterMclError`, or a `ValueError` where nothing can be localized in the map."""


@dataclass(frozen=True)
class ModelBuilt:
    """`BuildModel` is done."""

    map_digest: str
    model: SensorModel


@dataclass(frozen=True)
class HistoryArrived:
    """The bridge has answered `FetchScans`."""

    missing: MissingScans
    scans: tuple[Scan, ...]


@dataclass(frozen=True)
class HistoryFailed:
    """`FetchScans` has come to nothing."""

    missing: MissingScans
    problem: str


@dataclass(frozen=True)
class TimeToSearch:
    """There is time for a slice of what `Worker.searches`."""


Event: TypeAlias = (
    ScanArrived
    | CheckpointHeard
    | OrderAsked
    | BrokenOrderAsked
    | StateAsked
    | MapArrived
    | MapFailed
    | ModelBuilt
    | HistoryArrived
    | HistoryFailed
    | TimeToSearch
)
