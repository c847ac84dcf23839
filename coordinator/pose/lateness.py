"""How much later than usual data arrives: what a network has held up is older than it looks."""

WINDOW_NS = 5_000_000_000
"""Usual is the promptest of the last one to two windows: clocks drift by microseconds a second."""
MOST_NS = 5_000_000_000
"""Nothing is held up for longer, links break before: such a delay is a clock that was set back."""


class Lateness:
    """Compares a robot's stamps with the time of their arrival; the clocks need not agree."""

    def __init__(self) -> None:
        self._begun_ns: int | None = None
        self._least_ns = self._least_before_ns = 0

    def of(self, stamp_ns: int, now_ns: int) -> int:
        """How much later than the promptest of late this has come; never negative [ns].

        Args:
            stamp_ns: by the robot's clock.
            now_ns: of its arrival, by this process's.
        """
        delay_ns = now_ns - stamp_ns
        if self._begun_ns is None or delay_ns - self._usual_ns() > MOST_NS:
            self._begun_ns = now_ns
            self._least_ns = self._least_before_ns = delay_ns
        elif now_ns - self._begun_ns >= WINDOW_NS:
            self._begun_ns = now_ns
            self._least_before_ns, self._least_ns = self._least_ns, delay_ns
        self._least_ns = min(self._least_ns, delay_ns)
        return delay_ns - self._usual_ns()

    @property
    def usual_ns(self) -> int | None:
        """From a stamp to its arrival in time, by both clocks; None: nothing has come so far."""
        return None if self._begun_ns is None else self._usual_ns()

    def _usual_ns(self) -> int:
        return min(self._least_ns, self._least_before_ns)
