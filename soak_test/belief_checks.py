"""Promises about every belief: its probabilities sum to one, and its places are all there."""

import math

from protocol.answers import Belief
from protocol.job_events import Ended, JobEvents, event_text
from soak_test.verdict import KEPT_BREAKS, Break, Verdict

SUM_WITHIN = 1e-9
KEPT_ENDS = 200


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
        off = abs(math.fsum(h.probability for h in belief.hypotheses) - 1.0)
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


class Places:
    """As many places as there are: none is lost with a process."""

    def __init__(self, places: int) -> None:
        self._places = places
        self._complete = False
        self._beliefs = self._short = 0
        self._fewest = places
        self._breaks: list[Break] = []
        self._was_short = False
        self._held: set[int] = set()
        self._ends: dict[str, str] = {}
        """Why the last jobs ended."""
        self.changes: list[Break] = []
        """When a cluster came or went, for whoever looks for the reason."""

    @property
    def complete(self) -> bool:
        """Whether all have been found once: the bootstrap is over."""
        return self._complete

    def on_events(self, events: JobEvents) -> None:
        """Something has begun or ended; its belief is heard afterwards."""
        for numbered in events.events:
            if isinstance(numbered.event, Ended):
                self._ends[numbered.event.job_id] = event_text(numbered.event)
        while len(self._ends) > KEPT_ENDS:
            del self._ends[next(iter(self._ends))]

    def on_belief(self, at_ns: int, belief: Belief) -> None:
        """A belief was heard."""
        count = len(belief.hypotheses)
        self._complete = self._complete or count == self._places
        if not self._complete:
            return
        self._beliefs += 1
        short = count != self._places
        self._short += short
        self._fewest = min(self._fewest, count)
        if short and not self._was_short:
            self._breaks.append(Break(at_ns, f"{count} at step {belief.step}{self._gone(belief)}"))
        self._was_short = short
        self._note_changes(at_ns, belief)
        self._held = _places(belief)

    def verdict(self) -> Verdict:
        """Over all beliefs since all were found."""
        return Verdict(
            promise=f"all {self._places} places are kept",
            target="always",
            measured=f"not in {self._short:,} of {self._beliefs:,} beliefs; fewest {self._fewest}",
            kept=self._beliefs > 0 and not self._short,
            breaks=tuple(self._breaks[:KEPT_BREAKS]),
            figures={"short": self._short, "beliefs": self._beliefs, "fewest": self._fewest},
        )

    def _note_changes(self, at_ns: int, belief: Belief) -> None:
        now = _places(belief)
        came = sorted(now - self._held)
        if now != self._held and len(self.changes) < KEPT_BREAKS:
            what = "".join(f"; c{cluster} has come" for cluster in came) + self._gone(belief)
            self.changes.append(Break(at_ns, f"step {belief.step}{what}"))

    def _gone(self, belief: Belief) -> str:
        """Who is not there any more, and why."""
        gone = (f"c{cluster}" for cluster in sorted(self._held - _places(belief)))
        return "".join(
            f"; {self._ends.get(job_id, f'{job_id} has gone, nobody said why')}" for job_id in gone
        )


def _places(belief: Belief) -> set[int]:
    return {place.cluster for place in belief.hypotheses}
