"""Counts what a process does, and publishes its health once a second."""

import os
import time
from collections import Counter, deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from clustermcl.link.inbox import Inbox
from clustermcl.link.wire import Publisher
from clustermcl.protocol.health import MAX_WORDS, Health, SourceHealth
from clustermcl.runtime.logs import CauseCounter
from clustermcl.runtime.version import VERSION

RATE_OVER_S = 10.0
"""Rates are averaged over this time, or since the start [s]."""

_EVERY_S = 1.0


class HealthReporter:
    """Counts what a process does by kind, and publishes its health with what it dropped."""

    def __init__(
        self,
        name: str,
        role: str,
        causes: CauseCounter,
        inbox: Inbox[Any],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._name, self.role = name, role
        self._causes, self._inbox, self._clock = causes, inbox, clock
        self._started_s, self._published_s = clock(), -_EVERY_S
        self.sources: tuple[SourceHealth, ...] = ()
        self.gauges: dict[str, float] = {}
        self._done: Counter[str] = Counter()
        self._last_s: dict[str, float] = {}
        self._past: deque[tuple[float, Counter[str]]] = deque([(self._started_s, Counter())])

    def happened(self, what: str, times: int = 1) -> None:
        """Count an occurrence of `what`, a constant of the program."""
        now_s = self._clock()
        self._done[what] += times
        self._last_s[what] = now_s
        self._remember(now_s)

    def health(self) -> Health:
        now_s = self._clock()
        self._remember(now_s)
        since_s, before = self._past[0]
        elapsed_s = max(now_s - since_s, 1e-3)
        return Health(
            sender=self._name,
            role=self.role,
            version=VERSION,
            uptime_s=now_s - self._started_s,
            memory_bytes=memory_bytes(),
            done=dict(self._done),
            rates_per_s={w: (times - before[w]) / elapsed_s for w, times in self._done.items()},
            ages_s={what: now_s - last_s for what, last_s in self._last_s.items()},
            dropped=self.dropped(),
            sources=self.sources,
            gauges=self.gauges,
        )

    def dropped(self) -> dict[str, int]:
        """Return the counts by cause; of more than a message may have, the largest."""
        lost = {f"dropped {what}": count for what, count in self._inbox.dropped().items()}
        return dict((self._causes.total + Counter(lost)).most_common(MAX_WORDS))

    def publish_if_due(self, publisher: Publisher) -> None:
        now_s = self._clock()
        if now_s - self._published_s >= _EVERY_S:
            self._published_s = now_s
            publisher.put(self.health())

    def _remember(self, now_s: float) -> None:
        """Keep the counts of each second of the last `RATE_OVER_S`."""
        if now_s - self._past[-1][0] < _EVERY_S:
            return
        self._past.append((now_s, self._done.copy()))
        while len(self._past) > 2 and now_s - self._past[1][0] >= RATE_OVER_S:
            self._past.popleft()


def memory_bytes() -> int:
    """Return this process's resident memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
