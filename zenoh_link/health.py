"""Publishes the health of a process once a second."""

import os
import time
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from process_runtime.logs import CauseCounter
from protocol.health import Health
from zenoh_link.activity import Activity
from zenoh_link.inbox import Inbox
from zenoh_link.wire import Publisher

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
