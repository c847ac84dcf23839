"""Instructions of a coordinator, which `Loop` carries out."""

from dataclasses import dataclass
from typing import TypeAlias

from clustermcl.protocol.answers import Belief, CommandDone, PoseAnswer
from clustermcl.protocol.job_events import JobEvents
from clustermcl.protocol.work import Checkpoint, TakeOver, WorkOrder


@dataclass(frozen=True)
class SendOrder:
    """Send a work order to a worker."""

    worker: str
    order: WorkOrder


@dataclass(frozen=True)
class AskState:
    """Query a worker for its jobs, its reports and the terms that it knows."""

    worker: str
    question: TakeOver


@dataclass(frozen=True)
class PublishBelief:
    """Publish the belief, and the pose that follows from it."""

    belief: Belief
    pose: PoseAnswer


@dataclass(frozen=True)
class FetchScans:
    """Request the scans of lost steps from the bridge."""

    first: int
    last: int | None
    """None: up to the newest scan."""


@dataclass(frozen=True)
class FetchMap:
    """Request the map from the bridge; `MapArrived` contains its free ground."""


Instruction: TypeAlias = (
    SendOrder
    | AskState
    | PublishBelief
    | FetchScans
    | FetchMap
    | Checkpoint
    | JobEvents
    | CommandDone
)
"""A checkpoint and events are published; the answer to a command goes to its client."""
