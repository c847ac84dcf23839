"""The last events of a run, with those of earlier coordinators."""

from collections.abc import Iterable
from typing import Annotated, ClassVar

from msgspec import Meta

from clustermcl.belief.part import Count, Part
from clustermcl.protocol.job_events import JobEvent, NumberedEvent

KEPT_EVENTS = 200
HANDED_ON_EVENTS = 50
"""Limit for the events that a successor gets: each takes 110 bytes of every checkpoint."""


class EventLog(Part):
    """Numbers and keeps events."""

    local: ClassVar = frozenset({"unpublished"})
    kept: Annotated[list[NumberedEvent], Meta(max_length=KEPT_EVENTS)] = []
    count: Count = 0
    unpublished: list[NumberedEvent] = []

    def add(self, events: Iterable[JobEvent], step: int, stamp_ns: int) -> None:
        for event in events:
            numbered = NumberedEvent(number=self.count, step=step, stamp_ns=stamp_ns, event=event)
            self.count += 1
            self.kept.append(numbered)
            self.unpublished.append(numbered)
        del self.kept[:-KEPT_EVENTS], self.unpublished[:-KEPT_EVENTS]

    def recent(self) -> "EventLog":
        return EventLog(kept=self.kept[-HANDED_ON_EVENTS:], count=self.count)

    def news(self) -> tuple[NumberedEvent, ...]:
        """Return the events since the last call."""
        news, self.unpublished = tuple(self.unpublished), []
        return news
