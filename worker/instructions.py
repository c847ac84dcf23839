"""What a worker wants done; the rim carries it out."""

from dataclasses import dataclass
from typing import Any, TypeAlias

from particle_filter.settings import SensorSettings
from protocol.steps import MapMessage
from protocol.work import OrderAnswer, Report, WorkerState
from worker.job_table import MissingScans


@dataclass(frozen=True)
class PublishReport:
    """Tell the coordinator what a job made of a step."""

    report: Report


@dataclass(frozen=True)
class Answer:
    """Answer a question, once."""

    question: Any
    message: OrderAnswer | WorkerState


@dataclass(frozen=True)
class FetchMap:
    """Ask the bridge for the map: `MapArrived` or `MapFailed` follows."""


@dataclass(frozen=True)
class BuildModel:
    """Compute the sensor model of a map, or find it on disk: `ModelBuilt` or `MapFailed` follows.

    It takes up to a minute for a large map.
    """

    map: MapMessage
    settings: SensorSettings


@dataclass(frozen=True)
class FetchScans:
    """Ask the bridge for past steps: `HistoryArrived` or `HistoryFailed` follows."""

    missing: MissingScans
    timeout_s: float


@dataclass(frozen=True)
class Warn:
    """Count something that went wrong, and log it, though each cause only now and then."""

    cause: str
    """Fixed words."""
    detail: str


Instruction: TypeAlias = PublishReport | Answer | FetchMap | BuildModel | FetchScans | Warn
