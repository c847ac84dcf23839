"""Which workers are there: told of tokens and of the coordinator's own link.

A coordinator that loses its link to the router is told that every token has vanished, although
the workers behind it work on. So the membership is frozen while the link is down and a little
longer, and a vanished token counts only when the link has stood for a moment after it.
"""

from typing import TypeAlias

from coordinator.events import WorkerJoined, WorkerLeft, WorkerReturned
from coordinator.failover.failure_detector import SETTLE_NS

GRACE_NS = 2_000_000_000
"""After the link is back: twice the longest pause between two tries to connect."""


Change: TypeAlias = WorkerJoined | WorkerLeft | WorkerReturned
"""What a worker did."""


class Membership:
    """Turns tokens and links into changes that can be acted upon."""

    def __init__(self) -> None:
        self._present: set[str] = set()
        self._gone_ns: dict[str, int] = {}
        self._linked = True
        self._trust_from_ns = 0

    @property
    def linked(self) -> bool:
        """Whether this process has a link to the router."""
        return self._linked

    def link(self, up: bool, now_ns: int) -> None:
        """The own link came up or was lost."""
        if up and not self._linked:
            self._trust_from_ns = now_ns + GRACE_NS
        self._linked = up

    def token(self, worker: str, alive: bool, now_ns: int) -> list[Change]:
        """A worker's token appeared or vanished."""
        if not alive:
            if worker in self._present:
                self._gone_ns.setdefault(worker, now_ns)
            return []
        if worker not in self._present:
            self._present.add(worker)
            return [WorkerJoined(worker)]
        gone_ns = self._gone_ns.pop(worker, None)
        if gone_ns is None or self._away_with_our_link(now_ns):
            return [WorkerReturned(worker)]
        return [WorkerLeft(worker), WorkerJoined(worker)]

    def due(self, now_ns: int) -> list[Change]:
        """The workers whose absence has become certain."""
        if self._away_with_our_link(now_ns):
            return []
        left = [w for w, gone_ns in self._gone_ns.items() if now_ns >= gone_ns + SETTLE_NS]
        for worker in left:
            del self._gone_ns[worker]
            self._present.discard(worker)
        return [WorkerLeft(worker) for worker in sorted(left)]

    def _away_with_our_link(self, now_ns: int) -> bool:
        return not self._linked or now_ns < self._trust_from_ns
