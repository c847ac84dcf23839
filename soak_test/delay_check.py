"""Promise: the belief follows its scan soon."""

from collections import OrderedDict

from soak_test.availability import Availability
from soak_test.schedule import Kind
from soak_test.verdict import KEPT_BREAKS, Break, Verdict

_EXCUSED = {
    Kind.COORDINATOR_KILLED, Kind.COORDINATOR_FROZEN, Kind.COORDINATOR_LINK_CUT,
    Kind.ALL_WORKERS_KILLED, Kind.ROUTER_KILLED, Kind.ROUTER_FROZEN, Kind.SLOW_NETWORK,
}  # fmt: skip
_EXCUSED_S = 6.0
_KEPT_SCANS = 1024


class Delays:
    """From a scan to its belief, as one observer hears them; outages do not count.

    Args:
        availability: knows the outages.
        within_s: promised for 99 % of the steps; None: only measured.
        longest_s: promised for all steps: a worker that fails delays the others no longer.
    """

    def __init__(
        self, availability: Availability, within_s: float | None, longest_s: float
    ) -> None:
        self._availability, self._within_s, self._longest_s = availability, within_s, longest_s
        self._scans: OrderedDict[int, int] = OrderedDict()
        self._delays_s: list[float] = []
        self._slow: list[Break] = []

    def scan(self, at_ns: int, step: int) -> None:
        """A scan was heard; a repeated one is no news."""
        self._scans.setdefault(step, at_ns)
        while len(self._scans) > _KEPT_SCANS:
            self._scans.popitem(last=False)

    def believed(self, at_ns: int, step: int) -> None:
        """A belief was heard."""
        sent_ns = self._scans.pop(step, None)
        if sent_ns is None or self._availability.hit(_EXCUSED, sent_ns, at_ns, _EXCUSED_S):
            return
        delay_s = (at_ns - sent_ns) / 1e9
        self._delays_s.append(delay_s)
        if delay_s > self._longest_s:
            self._slow.append(Break(at_ns, f"step {step} took {delay_s:.2f} s"))

    def verdicts(self) -> list[Verdict]:
        """On 99 % of the steps and on the slowest."""
        ordered = sorted(self._delays_s)
        median_s, p99_s, longest_s = (
            ordered[int(share * (len(ordered) - 1))] if ordered else 0.0
            for share in (0.5, 0.99, 1.0)
        )
        within_s = self._within_s
        return [
            Verdict(
                promise="the belief follows its scan, 99 %",
                target="-" if within_s is None else f"within {within_s * 1e3:.0f} ms",
                measured=f"{p99_s * 1e3:.0f} ms (median {median_s * 1e3:.0f} ms)",
                kept=None if within_s is None else bool(ordered) and p99_s <= within_s,
                figures={"median_s": median_s, "p99_s": p99_s, "steps": len(ordered)},
            ),
            Verdict(
                promise="no step waits long for one worker",
                target=f"under {self._longest_s:g} s",
                measured=f"longest {longest_s:.2f} s; {len(self._slow)} over",
                kept=bool(ordered) and not self._slow,
                breaks=tuple(self._slow[:KEPT_BREAKS]),
                figures={"longest_s": longest_s, "over": len(self._slow)},
            ),
        ]
