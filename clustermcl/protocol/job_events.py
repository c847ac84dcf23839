"""Events of a run: what began or ended, and why; commands; faults of sensors."""

from collections.abc import Iterable, Iterator
from itertools import groupby
from typing import Annotated, ClassVar, Literal, TypeAlias

import msgspec
from msgspec import Meta

from clustermcl.protocol.message import LIST_BYTES, Id, Message, Number, Probability

MAX_DETAIL_CHARACTERS = 400

BeganCause: TypeAlias = Literal[
    "first search", "restart", "observed", "prior pose", "given", "split"
]
"""Found by the first search; found by a later one; allowed by
an observation; taken from the last pose; given by a command;
part of a cluster that split. An older release refuses a message with a cause it does not know."""

EndedCause: TypeAlias = Literal[
    "merged",
    "improbable",
    "pushed out",
    "split",
    "forgotten",
    "steps restarted",
    "new map",
    "search over",
    "search stopped",
]
"""Merged into another cluster; below `belief.least_probability`; replaced by a better candidate;
split into several; forgotten by a command; the bridge restarted its count of steps, so the robot's
motion is unknown; the bridge has another map. A search is complete, or a command replaced it."""


class Began(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="event", tag="began"
):
    """The start of a cluster."""

    job_id: Id
    """``c3`` for cluster 3."""
    cause: BeganCause
    """docs/wire.md lists all causes."""
    probability: Probability
    """Its probability at the start."""


class Ended(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="event", tag="ended"
):
    """The end of a cluster or a search."""

    job_id: Id
    """``c3`` for cluster 3; a search has its own kind of id."""
    cause: EndedCause
    """docs/wire.md lists all causes."""
    by: tuple[Id, ...] = ()
    """The cluster that it merged into, the ones that replaced it, or the ones it split into."""
    probability: Probability = 0.0
    """Its last probability; 0 for a search."""


class Remark(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="event",
    tag="remark",
):
    """Something else that explains a belief: a command, or a fault of the robot's sensors."""

    cause: Id
    """Such as ``pose given`` or ``odometry jumped``; docs/wire.md lists them."""
    detail: Annotated[str, Meta(max_length=MAX_DETAIL_CHARACTERS)] = ""
    """Numbers and names, in words."""


JobEvent: TypeAlias = Began | Ended | Remark


def is_of_search(event: JobEvent) -> bool:
    """Return whether an event is of a search, whose start is not an event."""
    return event.cause in ("search over", "search stopped")


def probability_of(event: JobEvent) -> float:
    """Return the probability of a place that began or ended; 1 for all other events."""
    return 1.0 if isinstance(event, Remark) or is_of_search(event) else event.probability


class NumberedEvent(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A job event with its number, step and time."""

    number: Number
    """Increases by one with each event of a coordinator's term."""
    step: int
    """Step of the event."""
    stamp_ns: int
    """Robot's clock at the scan of the step."""
    event: JobEvent
    """What began or ended, and why."""


class JobEvents(Message, frozen=True, kw_only=True, tag="events/1"):
    """Events of clusters and searches, commands, and faults of the robot's sensors.

    The coordinator publishes new events on ``events``, before the belief that they lead to. It
    answers queries there with the last 200 of its term: query after a gap in the numbers.
    """

    max_bytes: ClassVar[int] = LIST_BYTES
    events: tuple[NumberedEvent, ...]
    """Oldest first."""
    term: Number = 0
    """The coordinator's term; each term numbers its events from 0."""


def event_text(event: JobEvent) -> str:
    """Return an event as text: ``c3 merged into c1 (0.02)``."""
    match event:
        case Began(job_id, cause, probability):
            return f"{job_id} {_BEGAN[cause]} ({probability:.2g})"
        case Remark(cause=cause, detail=detail):
            return ": ".join(filter(None, (cause, detail)))
        case Ended(job_id, cause, by, probability):
            what = f"{job_id} {_ENDED[cause]} {' and '.join(by)}".rstrip()
            return what if is_of_search(event) else f"{what} ({probability:.2g})"


def event_texts(events: Iterable[NumberedEvent]) -> Iterator[str]:
    """Yield events as text with their steps; three or more of one step and cause share a text.

    Such as ``step 1: 19 places were found by the first search (0.24 to 0.00013)``.
    """
    for (step, _, cause), group in groupby(
        events, lambda n: (n.step, type(n.event), n.event.cause)
    ):
        alike = [numbered.event for numbered in group]
        of_jobs = [event for event in alike if not isinstance(event, Remark)]
        if is_of_search(alike[0]):  # one event for each shard
            searches = dict.fromkeys(event.job_id.partition(".")[0] for event in of_jobs)
            yield from (f"step {step}: search {search} {_TEXTS[cause]}" for search in searches)
            continue
        if len(of_jobs) < _ALIKE:
            yield from (f"step {step}: {event_text(event)}" for event in alike)
            continue
        what = _TEXTS[cause].replace("was ", "were ", 1)
        others = " others" if isinstance(alike[0], Ended) and alike[0].by else ""
        most, least = (pick(event.probability for event in of_jobs) for pick in (max, min))
        yield f"step {step}: {len(alike)} places {what}{others} ({most:.2g} to {least:.2g})"


_ALIKE = 3
_BEGAN: dict[BeganCause, str] = {
    "first search": "was found by the first search",
    "restart": "was found by a later search",
    "observed": "was found by an observation",
    "prior pose": "was restored from the last pose",
    "given": "was given by a command",
    "split": "was split off",
}
_ENDED: dict[EndedCause, str] = {
    "merged": "merged into",
    "improbable": "became too improbable",
    "pushed out": "was replaced by",
    "split": "split into",
    "forgotten": "was forgotten by a command",
    "new map": "was forgotten: the bridge has another map",
    "steps restarted": "was forgotten: the bridge restarted its count of steps",
    "search over": "is over",
    "search stopped": "was stopped",
}
_TEXTS: dict[str, str] = {str(cause): text for cause, text in (_BEGAN | _ENDED).items()}
