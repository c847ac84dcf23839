"""Why clusters and searches begin and end: in what the coordinator decides, and on the wire."""

from typing import Literal, TypeAlias

import msgspec

from protocol.message import Message

BeganCause: TypeAlias = Literal["first search", "restart", "prior pose", "given", "split"]
"""Found by the first search, or by a later one; known from earlier; given by a person; part of a
cluster that has fallen apart. Readers of releases that do not know a cause refuse its messages."""

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
"""Merged into another cluster; below `belief.least_probability`; pushed out by a newcomer;
fallen apart into several; forgotten by command; the bridge counts its steps anew, so that nobody
knows how the robot moved; the bridge was restarted with another map. A search has found what there
is, or a command made it needless."""


class Began(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="event", tag="began"
):
    """A cluster began."""

    job_id: str
    """``c3`` for cluster 3; searches have names of their own."""
    cause: BeganCause
    """Why."""
    probability: float
    """That it began with."""

    @property
    def is_search(self) -> bool:
        """False: of a search, only the end is told."""
        return False


class Ended(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="event", tag="ended"
):
    """A cluster, or a search, ended."""

    job_id: str
    """As in `Began`."""
    cause: EndedCause
    """Why."""
    by: tuple[str, ...] = ()
    """The job that it merged into or that pushed it out; the parts that it fell apart into."""
    probability: float = 0.0
    """That it had; 0 of a search."""

    @property
    def is_search(self) -> bool:
        """Whether it was a search."""
        return self.cause in ("search over", "search stopped")


JobEvent: TypeAlias = Began | Ended


class NumberedEvent(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One of them, and when it was."""

    number: int
    """Rises by one with each event of a coordinator's term."""
    step: int
    """At which it was."""
    stamp_ns: int
    """Robot's clock at the scan of the step."""
    event: JobEvent
    """What began or ended."""


class JobEvents(Message, frozen=True, kw_only=True, tag="events/1"):
    """What has begun and ended, oldest first.

    Answers queries on ``events`` with the last 200 of this coordinator's term. Published there
    with those that are new, before the belief they belong to; whoever misses a number asks.
    """

    events: tuple[NumberedEvent, ...]
    """Oldest first."""
    term: int = 0
    """The coordinator's term; each counts its events from 0."""


def event_text(event: JobEvent) -> str:
    """An event in a few words: ``c3 merged into c1 (0.02)``."""
    match event:
        case Began(job_id, cause, probability):
            return f"{job_id} {_BEGAN[cause]} ({probability:.2g})"
        case Ended(job_id, cause, by, probability):
            what = f"{job_id} {_ENDED[cause]} {' and '.join(by)}".rstrip()
            return what if event.is_search else f"{what} ({probability:.2g})"


_BEGAN: dict[BeganCause, str] = {
    "first search": "was found by the first search",
    "restart": "was found by a restart",
    "prior pose": "was known before",
    "given": "was given by a person",
    "split": "was split off",
}
_ENDED: dict[EndedCause, str] = {
    "merged": "merged into",
    "improbable": "became too improbable",
    "pushed out": "was pushed out by",
    "split": "fell apart into",
    "forgotten": "was forgotten by command",
    "new map": "was forgotten: the bridge has another map",
    "steps restarted": "was forgotten: the bridge counts its steps anew",
    "search over": "is over",
    "search stopped": "was stopped",
}
