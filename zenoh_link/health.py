"""Counts what a process does, and publishes its health once a second."""

import os
import time
from collections import Counter, deque
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from process_runtime.logs import CauseCounter
from protocol.health import Health
from zenoh_link.inbox import Inbox
from zenoh_link.wire import Publisher

RATE_OVER_S = 10.0
"""Rates are averaged over this time, or since the start [s]."""

_EVERY_S = 1.0


class Activity:
    """Counts events by kind; the kinds are constants of the program.

    Args:
        now_s: start of the process, on a clock that does not jump [s].
    """

    def __init__(self, now_s: float) -> None:
        self.done: Counter[str] = Counter()
        """Count of each kind since the start."""
        self._started_s = now_s
        self._last_s: dict[str, float] = {}
        self._past: deque[tuple[float, Counter[str]]] = deque([(now_s, Counter())])

    def happened(self, what: str, now_s: float, times: int = 1) -> None:
        self.done[what] += times
        self._last_s[what] = now_s
        if now_s - self._past[-1][0] >= _EVERY_S:
            self._remember(now_s)

    def rates_per_s(self, now_s: float) -> dict[str, float]:
        """Return the rate of each kind, averaged over `RATE_OVER_S` [1/s]."""
        if now_s - self._past[-1][0] >= _EVERY_S:
            self._remember(now_s)
        since_s, before = self._past[0]
        elapsed_s = max(now_s - since_s, 1e-3)
        return {what: (count - before[what]) / elapsed_s for what, count in self.done.items()}

    def ages_s(self, now_s: float) -> dict[str, float]:
        """Return the time since the last event of each kind [s]."""
        return {what: now_s - last_s for what, last_s in self._last_s.items()}

    def uptime_s(self, now_s: float) -> float:
        return now_s - self._started_s

    def _remember(self, now_s: float) -> None:
        self._past.append((now_s, self.done.copy()))
        while len(self._past) > 2 and now_s - self._past[1][0] >= RATE_OVER_S:
            self._past.popleft()


EVERY_S = 1.0

_STATM = Path("/proc/self/statm")


class HealthReporter:
    """Collects a process's counters and publishes them.

    Args:
        name: name of the process.
        role: ``bridge``, ``worker`` or ``coordinator``.
        causes: counts of dropped or refused input.
        inbox: its own drops are added.
    """

    def __init__(self, name: str, role: str, causes: CauseCounter, inbox: Inbox[Any]) -> None:
        self._name, self._role, self._version = name, role, version("clustermcl")
        self._causes, self._inbox = causes, inbox
        self._activity = Activity(time.monotonic())
        self._published_s = -EVERY_S

    def happened(self, what: str, times: int = 1) -> None:
        self._activity.happened(what, time.monotonic(), times)

    def health(self) -> Health:
        now_s = time.monotonic()
        return Health(
            sender=self._name,
            role=self._role,
            version=self._version,
            uptime_s=self._activity.uptime_s(now_s),
            memory_bytes=memory_bytes(),
            done=dict(self._activity.done),
            rates_per_s=self._activity.rates_per_s(now_s),
            ages_s=self._activity.ages_s(now_s),
            dropped=self.dropped(),
        )

    def dropped(self) -> dict[str, int]:
        """Return counts of dropped or refused input by cause."""
        lost: Mapping[str, int] = self._inbox.dropped()
        return {**self._causes.total, **{f"dropped {what}": count for what, count in lost.items()}}

    def publish_if_due(self, publisher: Publisher) -> None:
        """Publish if the last publication is at least `EVERY_S` old."""
        now_s = time.monotonic()
        if now_s - self._published_s >= EVERY_S:
            self._published_s = now_s
            publisher.put(self.health())


def memory_bytes() -> int:
    """Return this process's resident memory; 0 where ``/proc`` is not available."""
    try:
        pages = int(_STATM.read_text().split()[1])
    except (OSError, ValueError, IndexError):
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")
