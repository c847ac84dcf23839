"""Not more steps than are decided: an overloaded system takes fewer steps, and loses none."""

from collections import deque

MOST_WAITING = 4
"""Steps that went out and have no belief yet; with more, no scan becomes a step."""
OUTAGE_NS = 1_000_000_000
"""No belief for so long: nobody decides. Steps go on, for whoever takes over, and for workers."""


class FlowControl:
    """Told of steps and beliefs; says whether another step would only wait behind the others."""

    def __init__(self) -> None:
        self._waiting: deque[int] = deque()
        self._believed_ns: int | None = None

    def step_sent(self, step: int) -> None:
        """A step went out."""
        self._waiting.append(step)

    def believed(self, step: int, now_ns: int) -> None:
        """The belief of a step is out."""
        self._believed_ns = now_ns
        while self._waiting and self._waiting[0] <= step:
            self._waiting.popleft()

    def is_full(self, now_ns: int) -> bool:
        """Whether steps are decided, but more slowly than they are made."""
        if len(self._waiting) < MOST_WAITING or self._believed_ns is None:
            return False
        return now_ns - self._believed_ns < OUTAGE_NS
