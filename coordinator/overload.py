"""Whether steps are made faster than they are decided."""

from collections import deque
from statistics import median

STEPS = 20
"""One worker that dies holds up a few steps; an overload, most of so many."""
LATE_NS, IN_TIME_NS = 100_000_000, 50_000_000
"""From its scan to its decision half of the steps take longer; and again no longer than that."""


class OverloadDetector:
    """Told how long steps have waited."""

    def __init__(self) -> None:
        self._waits_ns: deque[int] = deque(maxlen=STEPS)
        self._overloaded = False

    @property
    def is_overloaded(self) -> bool:
        """Whether there is no time for what can be done later."""
        return self._overloaded

    def step_decided(self, waited_ns: int) -> None:
        """A step was decided so long after its scan had come."""
        self._waits_ns.append(waited_ns)
        if len(self._waits_ns) == STEPS:
            bound_ns = IN_TIME_NS if self._overloaded else LATE_NS
            self._overloaded = median(self._waits_ns) > bound_ns
