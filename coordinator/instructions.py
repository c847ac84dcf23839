"""What the coordinator wants done; the rim carries it out."""

from dataclasses import dataclass

from protocol.answers import Belief, CommandDone, PoseAnswer
from protocol.job_events import JobEvents
from protocol.work import Checkpoint, TakeOver, WorkOrder


@dataclass(frozen=True)
class SendOrder:
    """Ask a worker to follow an order."""

    worker: str
    order: WorkOrder


@dataclass(frozen=True)
class AskState:
    """Ask a worker what it does and what it knows of the coordinator before."""

    worker: str
    question: TakeOver


@dataclass(frozen=True)
class PublishCheckpoint:
    """Let others keep what a coordinator after this one would need."""

    checkpoint: Checkpoint


@dataclass(frozen=True)
class PublishBelief:
    """Tell everybody what is believed."""

    belief: Belief
    pose: PoseAnswer


@dataclass(frozen=True)
class PublishEvents:
    """Tell everybody what has begun and ended."""

    events: JobEvents


@dataclass(frozen=True)
class FetchScans:
    """Ask the bridge for steps whose scans were lost on their way."""

    first: int
    last: int | None
    """None: up to the newest."""


@dataclass(frozen=True)
class FetchMap:
    """Ask the bridge for its map, of which `MapArrived` keeps the free ground."""


@dataclass(frozen=True)
class AnswerCommand:
    """Tell the person who gave a command what came of it."""

    done: CommandDone


Instruction = (
    SendOrder
    | AskState
    | PublishCheckpoint
    | PublishEvents
    | PublishBelief
    | FetchScans
    | FetchMap
    | AnswerCommand
)
