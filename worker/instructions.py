"""The instructions of a worker, which its process carries out."""

from dataclasses import dataclass
from typing import Any, TypeAlias

from particle_filter.settings import SensorSettings
from protocol.steps import MapMessage
from protocol.work import OrderAnswer, Report, WorkerState
from worker.job_table import MissingScans


@dataclass(frozen=True)
class PublishReport:
    """Publish a job's report of a step."""

    report: Report


@dataclass(frozen=True)
class Answer:
    """Answer a query, once."""

    question: Any
    message: OrderAnswer | WorkerState


@dataclass(frozen=True)
class FetchMap:
    """Query the bridge for the map; `MapArrived` or `MapFailed` follows."""


@dataclass(frozen=True)
class BuildModel:
    """Compute the sensor model of a map, or read it; `ModelBuilt` or `MapFailed` follows.

    It takes up to a minute for a large map.
    """

    map: MapMessage
    settings: SensorSettings


@dataclass(frozen=True)
class FetchScans:
    """Query the bridge for past steps; `HistoryArrived` or `HistoryFailed` follows."""

    missing: MissingScans
    timeout_s: float


@dataclass(frozen=True)
class Warn:
    """Count a fault, and log each cause at most once a period."""

    cause: str
    """A constant."""
    detail: str


Instruction: TypeAlias = PublishReport | Answer | FetchMap | BuildModel | FetchScans | Warn
