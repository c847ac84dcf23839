"""Promise: the belief follows its scan soon."""

from collections import OrderedDict

from clustermcl.soak.availability import Availability
from clustermcl.soak.schedule import Kind
from clustermcl.soak.verdict import KEPT_BREAKS, Break, Verdict

_EXCUSED = {
    Kind.COORDINATOR_KILLED, Kind.COORDINATOR_FROZEN, Kind.ALL_WORKERS_KILLED,
    Kind.ROUTER_KILLED, Kind.ROUTER_FROZEN, Kind.SLOW_NETWORK,
}  # fmt: skip
_EXCUSED_S = 6.0
_KEPT_SCANS = 1024


class Delays:
    """From a scan to its belief, as one observer hears them; outages do not count.

    Args:
        availability: knows the outages.
        within_s: promised for 99 % of the steps.
        longest_s: promised for all steps: a worker that fails delays the others no longer.
    """

    def __init__(self, availability: Availability, within_s: float, longest_s: float) -> None:
        self._availability, self._within_s, self._longest_s = availability, within_s, longest_s
        self._scans: OrderedDict[int, int] = OrderedDict()
        self._delays: list[tuple[int, int, float]] = []

    def scan(self, at_ns: int, step: int) -> None:
        """A scan was heard; a repeated one is no news."""
        self._scans.setdefault(step, at_ns)
        while len(self._scans) > _KEPT_SCANS:
            self._scans.popitem(last=False)

    def believed(self, at_ns: int, step: int) -> None:
        """A belief was heard."""
        if (sent_ns := self._scans.pop(step, None)) is not None:
            self._delays.append((at_ns, step, (at_ns - sent_ns) / 1e9))

    def verdicts(self) -> list[Verdict]:
        """On 99 % of the steps and on the slowest."""
        counted = [delay for delay in self._delays if self._counts(*delay)]
        ordered = sorted(delay_s for _, _, delay_s in counted)
        median_s, p99_s, longest_s = (
            ordered[int(share * (len(ordered) - 1))] if ordered else 0.0
            for share in (0.5, 0.99, 1.0)
        )
        slow = [
            Break(at_ns, f"step {step} took {delay_s:.2f} s")
            for at_ns, step, delay_s in counted
            if delay_s > self._longest_s
        ]
        return [
            Verdict(
                promise="the belief follows its scan, 99 %",
                target=f"within {self._within_s * 1e3:.0f} ms",
                measured=f"{p99_s * 1e3:.0f} ms (median {median_s * 1e3:.0f} ms)",
                kept=bool(ordered) and p99_s <= self._within_s,
                figures={"median_s": median_s, "p99_s": p99_s, "steps": len(ordered)},
            ),
            Verdict(
                promise="no step waits long for one worker",
                target=f"under {self._longest_s:g} s",
                measured=f"longest {longest_s:.2f} s; {len(slow)} over",
                kept=bool(ordered) and not slow,
                breaks=tuple(slow[:KEPT_BREAKS]),
                figures={"longest_s": longest_s, "over": len(slow)},
            ),
        ]

    def _counts(self, at_ns: int, _step: int, delay_s: float) -> bool:
        begin_ns = at_ns - int(delay_s * 1e9)
        return self._availability.hit(_EXCUSED, begin_ns, at_ns, _EXCUSED_S) is None
