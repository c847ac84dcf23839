"""Events of a run: what began or ended, and why; commands; faults of sensors."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from typing import Annotated, ClassVar, Literal, TypeAlias

from msgspec import Meta

from clustermcl.protocol.message import LIST_BYTES, Id, Message, Number, Part, Probability

MAX_DETAIL_CHARACTERS = 400

BeganCause: TypeAlias = Literal[
    "first search", "restart", "observed", "prior pose", "given", "ride"
]
"""An older release refuses a message with a cause that it does not know; texts are in `_BEGAN`."""

EndedCause: TypeAlias = Literal[
    "merged", "improbable", "pushed out", "forgotten", "steps restarted",
    "own robot found", "new map", "search over", "search stopped",
]  # fmt: skip
"""Texts are in `_ENDED`; below `belief.least_probability` a cluster is improbable."""


class Began(Part, frozen=True, tag_field="event", tag="began"):
    """The start of a cluster."""

    job_id: Id
    """``c3`` for cluster 3."""
    cause: BeganCause
    """docs/wire.md lists all causes."""
    probability: Probability
    """Its probability at the start."""


class Ended(Part, frozen=True, tag_field="event", tag="ended"):
    """The end of a cluster or a search."""

    job_id: Id
    """``c3`` for cluster 3; a search has its own kind of id."""
    cause: EndedCause
    """docs/wire.md lists all causes."""
    by: tuple[Id, ...] = ()
    """The cluster that it merged into, or the ones that replaced it."""
    probability: Probability = 0.0
    """Its last probability; 0 for a search."""


class Remark(Part, frozen=True, kw_only=True, tag_field="event", tag="remark"):
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


class NumberedEvent(Part, frozen=True, kw_only=True):
    """A job event with its number, step and time."""

    number: Number
    """Increases by one with each event, also from a coordinator to the next."""
    step: int
    """Step of the event."""
    stamp_ns: int
    """Robot's clock at the scan of the step."""
    event: JobEvent
    """What began or ended, and why."""


class JobEvents(Message, frozen=True, kw_only=True, tag="events/1"):
    """Events of clusters and searches, commands, and faults of the robot's sensors.

    The coordinator publishes new events on ``events``, before the belief that they lead to. It
    answers queries there with the last 200: query after a gap in the numbers.
    """

    max_bytes: ClassVar[int] = LIST_BYTES
    events: tuple[NumberedEvent, ...]
    """Oldest first."""
    term: Number = 0
    """The coordinator's term. The events of a higher one replace those with the same numbers."""


def event_text(event: JobEvent) -> str:
    """Return an event as text: ``place 3 merged into place 1 (2.1 %)``."""
    match event:
        case Began(job_id, cause, probability):
            return f"{_name(job_id)} {_BEGAN[cause]} ({_percent(probability)})"
        case Ended(job_id, cause, by, probability):
            what = f"{_name(job_id)} {_ENDED[cause]} {' and '.join(map(_name, by))}".rstrip()
            return what if is_of_search(event) else f"{what} ({_percent(probability)})"
        case Remark(cause=cause, detail=detail):
            return ": ".join(filter(None, (cause, detail)))


def event_groups(events: Iterable[NumberedEvent]) -> Iterator[tuple[Sequence[NumberedEvent], str]]:
    """Yield events with their text; three or more of one step and cause share a text.

    Such as ``19 places found by the first search (24 % to < 0.1 %)``.
    """
    for (_, _, cause), group in groupby(events, lambda n: (n.step, type(n.event), n.event.cause)):
        alike = list(group)
        match [numbered.event for numbered in alike]:
            case [Ended() as first, *_] as ended if is_of_search(first):  # one for each shard
                texts = dict.fromkeys(map(event_text, ended))
                yield from ((alike, text) for text in texts)
            case [Began() | Ended() as first, _, _, *_] as many:
                others = " others" if isinstance(first, Ended) and first.by else ""
                shares = [one.probability for one in many if not isinstance(one, Remark)]
                most, least = _percent(max(shares)), _percent(min(shares))
                span = most if most == least else f"{most} to {least}"
                yield alike, f"{len(alike)} places {(_BEGAN | _ENDED)[cause]}{others} ({span})"
            case _:
                yield from (([numbered], event_text(numbered.event)) for numbered in alike)


def event_texts(events: Iterable[NumberedEvent]) -> Iterator[str]:
    """Yield the texts of `event_groups` with their steps: ``step 9: search 2 is over``."""
    return (f"step {alike[0].step}: {text}" for alike, text in event_groups(events))


def _name(job_id: str) -> str:
    """Return ``place 3`` for the job ``c3``, and ``search 2`` for its shard ``s2.0``."""
    number = job_id[1:].partition(".")[0]
    return f"{_KINDS[job_id[0]]} {number}" if job_id[0] in _KINDS else job_id


def _percent(probability: float) -> str:
    percent = 100.0 * probability
    return "< 0.1 %" if percent < 0.1 else f"{percent:.{0 if percent >= 9.95 else 1}f} %"


_KINDS = {"c": "place", "s": "search", "m": "search of the mirrored scan", "d": "mirrored place"}
_BEGAN: dict[BeganCause, str] = {
    "first search": "found by the first search",
    "restart": "found by a later search",
    "observed": "found by an observation",
    "prior pose": "restored from the last pose",
    "given": "given by a command",
    "ride": "reached by a lift or another link",
}
_ENDED: dict[EndedCause, str] = {
    "merged": "merged into",
    "improbable": "dropped: improbable",
    "pushed out": "replaced by",
    "forgotten": "dropped by a command",
    "new map": "dropped: the bridge has another map",
    "steps restarted": "dropped: the bridge restarted its count of steps",
    "own robot found": "dropped: the scans showed the robot itself",
    "search over": "is over",
    "search stopped": "was stopped",
}
