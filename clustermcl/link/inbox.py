"""A bounded queue from Zenoh's callbacks to the one loop of a process."""

import threading
import time
from collections import Counter, deque
from collections.abc import Mapping
from typing import Generic, TypeVar

EventT = TypeVar("EventT")

MAX_KIND_BYTES = 128 * 1024 * 1024
"""Most bytes of queued payloads, for each kind of state and for events. Counts bound normal
traffic; this bounds the memory that large messages from unknown senders can take."""


class Inbox(Generic[EventT]):
    """Bounded queue from many threads to one, in the order of arrival; a put never blocks.

    A callback that blocks stalls every subscription and query of its session. *States* (scans,
    odometry): a full inbox drops the oldest of its kind, because the next one replaces it.
    *Events* (assignments, liveliness, queries) have their own bound: past it the newest is
    refused, and the callback can reply with an error. Messages with a `payload` are also bounded
    by their bytes.
    """

    def __init__(
        self,
        keep_newest: Mapping[str, int],
        *,
        max_events: int = 4096,  # more means that the loop hangs
        max_kind_bytes: int = MAX_KIND_BYTES,
    ) -> None:
        self._states: dict[str, _Waiting[EventT]] = {}
        self._events, self._max_bytes = _Waiting[EventT](max_events), max_kind_bytes
        self._arrived = 0
        self._dropped: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._news = threading.Lock()
        """Locked while the queue is empty. A bare lock: a `Condition` allocates one per message."""
        self._news.acquire()
        for kind, count in keep_newest.items():
            self.keep(kind, count)

    def keep(self, kind: str, count: int) -> None:
        """Add a kind of state, of which at most `count`, one or more, are queued."""
        with self._lock:
            self._states.setdefault(kind, _Waiting(count)).bound = count

    def put(self, event: EventT) -> bool:
        """Append an event; return False if the inbox is full."""
        with self._lock:
            is_full = self._is_full(self._events, event)
            if is_full:
                self._dropped["event"] += 1
            else:
                self._append(self._events, event)
            return not is_full

    def put_own(self, event: EventT) -> None:
        """Append an event from this process itself, even past `max_events`.

        A timer refused because other processes fill the inbox would never fire again. The number
        of own events is bounded by the process's own requests.
        """
        with self._lock:
            self._append(self._events, event)

    def put_newest(self, kind: str, state: EventT) -> None:
        """Append a state and drop the oldest of its kind if there are too many."""
        with self._lock:
            waiting = self._states[kind]
            while waiting.queue and self._is_full(waiting, state):
                waiting.popleft()
                if waiting.bound > 1:  # with a bound of 1 replacing is not a loss
                    self._dropped[kind] += 1
            self._append(waiting, state)

    def count_refused(self, kind: str) -> None:
        with self._lock:
            self._dropped[f"{kind} too large"] += 1

    def get(self, timeout_s: float) -> EventT | None:
        """Remove and return the oldest message; None if none arrives within `timeout_s` [s].

        Python runs signal handlers during the wait without ending it, so loops that check a
        `StopFlag` use a 0.1 s time-out.
        """
        until_s = time.monotonic() + timeout_s
        while True:
            with self._lock:
                queues = (self._events, *self._states.values())
                filled = [waiting for waiting in queues if waiting.queue]
                if filled:
                    return min(filled, key=lambda waiting: waiting.queue[0][0]).popleft()
                self._news.acquire(blocking=False)
            left_s = until_s - time.monotonic()
            if left_s <= 0.0 or not self._news.acquire(timeout=left_s):
                return None

    def dropped(self) -> dict[str, int]:
        """Return counts of lost messages by kind of state; refused events count as ``event``."""
        with self._lock:
            return dict(self._dropped)

    def _is_full(self, waiting: "_Waiting[EventT]", event: EventT) -> bool:
        is_long = len(waiting.queue) >= waiting.bound
        return is_long or waiting.bytes + _size(event) > self._max_bytes

    def _append(self, waiting: "_Waiting[EventT]", event: EventT) -> None:
        waiting.queue.append((self._arrived, event))
        waiting.bytes += _size(event)
        self._arrived += 1
        if self._news.locked():
            self._news.release()


class _Waiting(Generic[EventT]):
    """A queue of numbered events, its bound, and the bytes of their payloads."""

    def __init__(self, bound: int) -> None:
        self.bound = bound
        self.queue: deque[tuple[int, EventT]] = deque()
        self.bytes = 0

    def popleft(self) -> EventT:
        _, event = self.queue.popleft()
        self.bytes -= _size(event)
        return event


def _size(event: object) -> int:
    return len(getattr(event, "payload", b""))
