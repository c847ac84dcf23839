"""Counts, rates and ages of what a process does."""

from collections import Counter, deque

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
