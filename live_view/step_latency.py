"""Time from a scan to its belief, measured by the process that receives both."""

import statistics
from collections import deque
from typing import Any

LAST_STEPS = 100
_WAITING_SCANS = 64


class StepLatency:
    """Measures by one clock, so that no clocks have to agree."""

    def __init__(self) -> None:
        self._scans_ns: dict[int, int] = {}
        self._late_ms: deque[float] = deque(maxlen=LAST_STEPS)

    def on_scan(self, step: int, at_ns: int) -> None:
        """A scan has arrived; its belief follows."""
        self._scans_ns[step] = at_ns
        while len(self._scans_ns) > _WAITING_SCANS:
            del self._scans_ns[next(iter(self._scans_ns))]

    def on_belief(self, step: int, at_ns: int) -> None:
        """A belief has arrived. Only the first of its step counts: commands publish more."""
        scan_ns = self._scans_ns.pop(step, None)
        if scan_ns is not None:
            self._late_ms.append((at_ns - scan_ns) / 1e6)

    def frame(self) -> dict[str, Any] | None:
        """Return the times for the page [ms]; None: no belief has arrived yet."""
        late_ms = self._late_ms
        if not late_ms:
            return None
        return {
            "last": round(late_ms[-1], 1),
            "median": round(statistics.median(late_ms), 1),
            "most": round(max(late_ms), 1),
            "steps": len(late_ms),
        }
