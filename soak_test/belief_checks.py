"""Of every belief: its probabilities and elsewhere sum to one; which clusters came and went."""

import math

from protocol.answers import Belief
from soak_test.end_causes import EndCauses
from soak_test.verdict import KEPT_BREAKS, Break, Verdict

SUM_WITHIN = 1e-9


class Probabilities:
    """Those of all places sum to one."""

    def __init__(self) -> None:
        self._beliefs, self._worst = 0, 0.0
        self._breaks: list[Break] = []

    def on_belief(self, at_ns: int, belief: Belief) -> None:
        """A belief was heard."""
        if not belief.hypotheses:
            return
        self._beliefs += 1
        here = math.fsum(h.probability for h in belief.hypotheses)
        off = abs(here + belief.elsewhere_probability - 1.0)
        self._worst = max(self._worst, off)
        if not off <= SUM_WITHIN:
            self._breaks.append(Break(at_ns, f"off by {off:.1e} at step {belief.step}"))

    def verdict(self) -> Verdict:
        """Over all beliefs."""
        return Verdict(
            promise="probabilities sum to 1",
            target=f"within {SUM_WITHIN:.0e}",
            measured=f"{self._beliefs:,} beliefs, worst {self._worst:.0e}",
            kept=self._beliefs > 0 and not self._breaks,
            breaks=tuple(self._breaks[:KEPT_BREAKS]),
            figures={"beliefs": self._beliefs, "worst": self._worst},
        )


class ClusterChanges:
    """When a cluster came or went, for whoever looks for the reason.

    Args:
        causes: told of everything that ends before the beliefs without it.
    """

    def __init__(self, causes: EndCauses) -> None:
        self._causes = causes
        self._held: set[int] = set()
        self.changes: list[Break] = []

    def on_belief(self, at_ns: int, belief: Belief) -> None:
        """A belief was heard."""
        now = {place.cluster for place in belief.hypotheses if place.cluster >= 0}
        came = [f"c{cluster} has come" for cluster in sorted(now - self._held)]
        gone = [self._causes.of(f"c{cluster}") for cluster in sorted(self._held - now)]
        if (came or gone) and len(self.changes) < KEPT_BREAKS:
            self.changes.append(Break(at_ns, "; ".join((f"step {belief.step}", *came, *gone))))
        self._held = now
