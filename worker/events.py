"""The events of a worker: plain facts, so that a test is a list of them."""

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
    """Scans that this process dropped from a full inbox since its start."""


@dataclass(frozen=True)
class CheckpointHeard:
    """A coordinator published its state, so it has begun and lives."""

    checkpoint: Checkpoint


@dataclass(frozen=True)
class OrderAsked:
    """A coordinator gave an order and waits for the answer."""

    question: Any
    """Handle of the query, for its `Answer`."""
    order: WorkOrder


@dataclass(frozen=True)
class BrokenOrderAsked:
    """A malformed order was received, which needs an answer too."""

    question: Any
    error: MalformedMessageError


@dataclass(frozen=True)
class StateAsked:
    """A client or a coordinator queries the worker's jobs."""

    question: Any
    take_over: TakeOver | None = None
    """From a new coordinator, which needs the whole state."""


@dataclass(frozen=True)
class MapArrived:
    """The bridge has answered `FetchMap`."""

    message: MapMessage


@dataclass(frozen=True)
class MapFailed:
    """`FetchMap` or `BuildModel` failed."""

    error: Exception
    """A `ClusterMclError`, or a `ValueError` if the map has no obstacle."""


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
    """`FetchScans` failed."""

    missing: MissingScans
    problem: str


@dataclass(frozen=True)
class TimeToSearch:
    """There is time for a slice of a search; see `Worker.searches`."""


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
