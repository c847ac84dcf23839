"""The inbox: Zenoh's callbacks put, the process's one loop takes."""

import threading
import time
from collections import Counter, deque
from collections.abc import Mapping
from typing import Generic, TypeVar

EventT = TypeVar("EventT")

MAX_KIND_BYTES = 128 * 1024 * 1024
"""Of the payloads that wait, for each kind of state and for events: counts bound honest traffic,
this bounds the memory that large messages of a stranger's can take."""


class Inbox(Generic[EventT]):
    """Bounded queue from many threads to one, in the order of arrival; a put never waits.

    A callback that waits stalls, 256 messages later, every subscription and query of its
    session. So a full inbox gives way: of the *states* (scans, odometry) the oldest of the
    same kind is dropped, for the next repairs it. *Events* (assignments, liveliness, queries)
    are never dropped for a state; past their own bound the newest is refused, and the caller
    can say so to whoever asks. What has a `payload` also counts by its bytes.
    """

    def __init__(
        self,
        keep_newest: Mapping[str, int],
        *,
        max_events: int = 4096,
        max_kind_bytes: int = MAX_KIND_BYTES,
    ) -> None:
        """Set the bounds.

        Args:
            keep_newest: kinds of states, and how many of each are kept.
            max_events: events that may wait; more means that the loop hangs.
            max_kind_bytes: bytes of payloads that may wait of each kind, and of events.

        Raises:
            ValueError: a bound is less than one.
        """
        if min([max_events, *keep_newest.values()]) < 1:
            raise ValueError("an inbox keeps at least one of each kind")
        self._states = {kind: _Waiting[EventT]() for kind in keep_newest}
        self._bounds = dict(keep_newest)
        self._events = _Waiting[EventT]()
        self._max_events, self._max_bytes = max_events, max_kind_bytes
        self._arrived = 0
        self._closed = False
        self._dropped: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._news = threading.Lock()
        """Held while the loop has seen all there is. A bare lock: a `Condition` makes and takes
        some more for every message."""
        self._news.acquire()

    def put(self, event: EventT) -> bool:
        """Append an event; return False if it was refused, the inbox being full or closed."""
        with self._lock:
            if self._closed:
                return False
            full = len(self._events.queue) >= self._max_events
            if full or self._events.bytes + _size(event) > self._max_bytes:
                self._dropped["event"] += 1
                return False
            self._append(self._events, event)
            return True

    def put_own(self, event: EventT) -> None:
        """Append what this process sends to itself: its own questions bound how much that is.

        Others' events may fill the inbox; a timer that were refused then would never come again.
        """
        with self._lock:
            if not self._closed:
                self._append(self._events, event)

    def put_newest(self, kind: str, state: EventT) -> None:
        """Append a state; the oldest of its kind gives way when there are too many.

        Raises:
            KeyError: the inbox was not made for this kind.
        """
        with self._lock:
            waiting = self._states[kind]
            if self._closed:
                return
            while len(waiting.queue) >= self._bounds[kind] or (
                waiting.queue and waiting.bytes + _size(state) > self._max_bytes
            ):
                waiting.popleft()
                if self._bounds[kind] > 1:  # else only the newest was ever wanted
                    self._dropped[kind] += 1
            self._append(waiting, state)

    def count_refused(self, kind: str) -> None:
        """Count what was refused before it got here, as being too large."""
        with self._lock:
            self._dropped[f"{kind} too large"] += 1

    def get(self, timeout_s: float) -> EventT | None:
        """Take what arrived first, waiting at most so long; None if nothing came.

        What was put before the inbox was closed is still handed out. Python runs signal
        handlers during the wait but does not end it: loops that look at a `StopFlag` wait
        0.1 s at a time.
        """
        until_s = time.monotonic() + timeout_s
        while True:
            with self._lock:
                oldest = self._oldest()
                if oldest is not None:
                    return oldest.popleft()
                if self._closed:
                    return None
                self._news.acquire(blocking=False)
            left_s = until_s - time.monotonic()
            if left_s <= 0.0 or not self._news.acquire(timeout=left_s):
                return None

    def close(self) -> None:
        """Accept no more and wake the loop; may be called again."""
        with self._lock:
            self._closed = True
            self._tell()

    def dropped(self) -> dict[str, int]:
        """How many were lost here: by kind of state, refused events as ``event``."""
        with self._lock:
            return dict(self._dropped)

    def _append(self, waiting: "_Waiting[EventT]", event: EventT) -> None:
        waiting.append(self._arrived, event)
        self._arrived += 1
        self._tell()

    def _tell(self) -> None:
        """Wake the loop; called under the lock."""
        if self._news.locked():
            self._news.release()

    def _oldest(self) -> "_Waiting[EventT] | None":
        """The queue whose head arrived first; None if all are empty."""
        filled = [waiting for waiting in (self._events, *self._states.values()) if waiting.queue]
        return min(filled, key=lambda waiting: waiting.queue[0][0], default=None)


class _Waiting(Generic[EventT]):
    """A queue of numbered events that knows how many bytes wait in it."""

    def __init__(self) -> None:
        self.queue: deque[tuple[int, EventT]] = deque()
        self.bytes = 0

    def append(self, number: int, event: EventT) -> None:
        self.queue.append((number, event))
        self.bytes += _size(event)

    def popleft(self) -> EventT:
        _, event = self.queue.popleft()
        self.bytes -= _size(event)
        return event


def _size(event: object) -> int:
    return len(getattr(event, "payload", b""))
