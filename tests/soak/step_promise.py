"""Promise: each step is decided once, in time."""

from collections import OrderedDict

from protocol.answers import Belief
from tests.soak.promise import (
    BACK_WITHIN_S,
    KEPT_BREAKS,
    NO_COORDINATOR,
    NO_NETWORK,
    NO_WORKERS,
    Break,
    Outages,
    Verdict,
)

SAME_WITHIN = 1e-9
_WORKERS_START_S = 2.0
"""Added to `BACK_WITHIN_S`: workers take longer to start than a coordinator."""
_REPEATED_WITHIN_S = 30.0
_KEPT = 4096


class StepsOnce:
    """Each step has one belief, with an excuse for each that is missing.

    Excused are steps while the network was down, or while there was no coordinator or no worker.
    A coordinator that takes over may publish a belief again if it is the same within 1e-9.

    Args:
        outages: what is excused.
        longest_s: from a scan to its belief.
    """

    def __init__(self, outages: Outages, longest_s: float) -> None:
        self._outages, self._longest_s = outages, longest_s
        self._scans: OrderedDict[int, int] = OrderedDict()
        self._seen: OrderedDict[int, dict[int, float]] = OrderedDict()
        self._last: tuple[int, int] | None = None
        self._lost = self._excused = self._repeated = self._steps = 0
        self._delays_s: list[float] = []
        self._breaks: list[Break] = []

    def on_scan(self, at_ns: int, step: int) -> None:
        """Take a scan; a repeated one is ignored."""
        self._scans.setdefault(step, at_ns)
        while len(self._scans) > _KEPT:
            self._scans.popitem(last=False)

    def on_belief(self, at_ns: int, belief: Belief) -> None:
        now = {place.cluster: place.probability for place in belief.hypotheses}
        if (before := self._seen.get(belief.step)) is not None:
            self._on_repeated(at_ns, belief.step, before, now)
            return
        self._steps += 1
        self._seen[belief.step] = now
        while len(self._seen) > _KEPT:
            self._seen.popitem(last=False)
        if self._last is not None and belief.step > self._last[0] + 1:
            self._on_gap(self._last[1], at_ns, belief.step - self._last[0] - 1, belief.step)
        self._last = max(self._last or (-1, 0), (belief.step, at_ns))
        sent_ns = self._scans.pop(belief.step, None)
        if sent_ns is not None and not self._is_excused(sent_ns, at_ns):
            self._on_delay(at_ns, belief.step, (at_ns - sent_ns) / 1e9)

    def verdict(self) -> Verdict:
        ordered = sorted(self._delays_s)
        median_s, p99_s, longest_s = (
            ordered[int(share * (len(ordered) - 1))] if ordered else 0.0
            for share in (0.5, 0.99, 1.0)
        )
        return Verdict(
            promise="each step is decided once",
            target=f"all, within {self._longest_s:g} s",
            measured=f"{self._lost} of {self._steps:,} lost, {self._excused} in outages; "
            f"{self._repeated} repeated; delay {median_s * 1e3:.0f} ms (99 %: "
            f"{p99_s * 1e3:.0f} ms, longest {longest_s:.2f} s)",
            kept=self._steps > 0 and not self._breaks,
            breaks=tuple(self._breaks[:KEPT_BREAKS]),
            figures={
                "steps": self._steps,
                "lost": self._lost,
                "lost_in_outages": self._excused,
                "repeated": self._repeated,
                "median_s": median_s,
                "p99_s": p99_s,
                "longest_s": longest_s,
            },
        )

    def _is_excused(self, begin_ns: int, end_ns: int) -> bool:
        excuse = self._outages.excuse
        return bool(
            excuse(NO_COORDINATOR | NO_NETWORK, begin_ns, end_ns)
            or excuse(NO_WORKERS, begin_ns, end_ns, BACK_WITHIN_S + _WORKERS_START_S)
        )

    def _on_gap(self, begin_ns: int, end_ns: int, missing: int, before: int) -> None:
        if self._is_excused(begin_ns, end_ns):
            self._excused += missing
            return
        self._lost += missing
        self._breaks.append(Break(end_ns, f"{missing} steps before step {before} are lost"))

    def _on_delay(self, at_ns: int, step: int, delay_s: float) -> None:
        self._delays_s.append(delay_s)
        if delay_s > self._longest_s:
            self._breaks.append(Break(at_ns, f"step {step} took {delay_s:.2f} s"))

    def _on_repeated(
        self, at_ns: int, step: int, before: dict[int, float], now: dict[int, float]
    ) -> None:
        self._repeated += 1
        restarted = self._outages.excuse(NO_COORDINATOR, at_ns, at_ns, _REPEATED_WITHIN_S)
        apart = max((abs(now.get(c, 0.0) - before.get(c, 0.0)) for c in now | before), default=0.0)
        if not restarted:
            self._breaks.append(Break(at_ns, f"step {step} again"))
        elif apart > SAME_WITHIN:
            self._breaks.append(Break(at_ns, f"step {step} again, {apart:.1e} apart"))
