"""Instructions of a coordinator, which `Loop` carries out."""

from typing import TypeAlias

import msgspec

from clustermcl.protocol.answers import Belief, CommandDone, PoseAnswer
from clustermcl.protocol.job_events import JobEvents
from clustermcl.protocol.work import Checkpoint, TakeOver, WorkOrder


class SendOrder(msgspec.Struct, frozen=True):
    """Send a work order to a worker."""

    worker: str
    order: WorkOrder


class AskState(msgspec.Struct, frozen=True):
    """Query a worker for its jobs, its reports and the terms that it knows."""

    worker: str
    question: TakeOver


class FetchScans(msgspec.Struct, frozen=True):
    """Request the scans of lost steps from the bridge."""

    first: int
    last: int | None
    """None: up to the newest scan."""


class FetchMap(msgspec.Struct, frozen=True):
    """Request the map from the bridge; `MapArrived` contains its free ground."""


Instruction: TypeAlias = (
    SendOrder | AskState | FetchScans | FetchMap
    | Checkpoint | JobEvents | Belief | PoseAnswer | CommandDone
)  # fmt: skip
"""Messages are published, but the answer to a command goes to its client."""
