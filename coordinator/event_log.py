"""What has begun and ended of late, for those who ask why a cluster went."""

from collections import deque
from collections.abc import Iterable

from protocol.job_events import JobEvent, NumberedEvent

KEPT_EVENTS = 200


class EventLog:
    """The last events of one coordinator; a coordinator after it begins with none."""

    def __init__(self) -> None:
        self._kept: deque[NumberedEvent] = deque(maxlen=KEPT_EVENTS)
        self._count = 0
        self._news: list[NumberedEvent] = []

    def add(self, events: Iterable[JobEvent], step: int, stamp_ns: int) -> None:
        """Keep what a step or a command came to.

        Args:
            events: in the order in which they were decided.
            step: after which they hold.
            stamp_ns: robot's clock at the scan of the step.
        """
        for event in events:
            numbered = NumberedEvent(number=self._count, step=step, stamp_ns=stamp_ns, event=event)
            self._count += 1
            self._kept.append(numbered)
            self._news.append(numbered)

    def all(self) -> tuple[NumberedEvent, ...]:
        """All that are kept, oldest first."""
        return tuple(self._kept)

    def news(self) -> tuple[NumberedEvent, ...]:
        """Those that have come since the last call."""
        news, self._news = tuple(self._news), []
        return news
