"""Promises about the stream of beliefs: its numbers, its steps, its places, and the truth."""

import math
from collections import OrderedDict

from clustermcl.metrics import CONFIDENT_PROBABILITY, PoseError, pose_error
from clustermcl.soak.availability import Availability
from clustermcl.soak.schedule import Kind
from clustermcl.soak.verdict import KEPT_BREAKS, Break, Verdict
from protocol.answers import Belief
from protocol.message import PoseTuple

SUM_WITHIN = 1e-9
TRUTH_TRACKED_SHARE = 0.99
_KEPT_TRUTHS = 4096
_RESTARTS = {Kind.COORDINATOR_KILLED, Kind.COORDINATOR_FROZEN}
_RESTART_S = 5.0


class Probabilities:
    """Those of all places sum to one."""

    def __init__(self) -> None:
        self._beliefs, self._worst = 0, 0.0
        self._breaks: list[Break] = []

    def take(self, at_ns: int, belief: Belief) -> None:
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


class Steps:
    """Each step is believed once; one that is missing needs an excuse.

    Excused is what the network could not carry while it was down, and what a coordinator that
    was not there has not believed; how many that were is told.
    """

    def __init__(self, availability: Availability) -> None:
        self._availability = availability
        self._last: tuple[int, int] | None = None
        self._believed = 0
        self._gaps: list[tuple[int, int, int, int]] = []
        self._repeated: list[Break] = []

    def take(self, at_ns: int, belief: Belief) -> None:
        """A belief was heard."""
        self._believed += 1
        if self._last is not None:
            last_step, last_ns = self._last
            if belief.step <= last_step:
                self._repeated.append(Break(at_ns, f"step {belief.step} after {last_step}"))
                return
            if belief.step > last_step + 1:
                self._gaps.append((last_ns, at_ns, last_step + 1, belief.step - 1))
        self._last = belief.step, at_ns

    def verdicts(self) -> list[Verdict]:
        """On steps lost and on steps doubled."""
        broken: list[Break] = []
        lost = in_network = without_coordinator = 0
        for begin_ns, end_ns, first, last in self._gaps:
            count = last - first + 1
            if self._availability.cut_off(begin_ns, end_ns):
                in_network += count
            elif self._availability.hit(_RESTARTS, begin_ns, end_ns, _RESTART_S):
                without_coordinator += count
            else:
                lost += count
                broken.append(Break(end_ns, f"steps {first} to {last}"))
        return [
            Verdict(
                promise="no step is lost",
                target="none but in outages",
                measured=f"{lost} of {self._believed:,}; in outages: network {in_network}, "
                f"coordinator {without_coordinator}",
                kept=self._believed > 0 and not broken,
                breaks=tuple(broken[:KEPT_BREAKS]),
                figures={
                    "believed": self._believed,
                    "lost": lost,
                    "lost_without_network": in_network,
                    "lost_without_coordinator": without_coordinator,
                },
            ),
            Verdict(
                promise="no step is believed twice",
                target="none",
                measured=f"{len(self._repeated)}",
                kept=not self._repeated,
                breaks=tuple(self._repeated[:KEPT_BREAKS]),
                figures={"repeated": len(self._repeated)},
            ),
        ]


class Places:
    """As many places as there are: none is lost with a process."""

    def __init__(self, places: int) -> None:
        self._places = places
        self._complete = False
        self._beliefs = self._short = 0
        self._fewest = places
        self._breaks: list[Break] = []
        self._was_short = False

    @property
    def complete(self) -> bool:
        """Whether all have been found once: the bootstrap is over."""
        return self._complete

    def take(self, at_ns: int, belief: Belief) -> None:
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
            self._breaks.append(Break(at_ns, f"{count} places at step {belief.step}"))
        self._was_short = short

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


class Truth:
    """One of the places is where the robot is, and nothing else is believed for certain."""

    def __init__(self) -> None:
        self._truths: OrderedDict[int, PoseTuple] = OrderedDict()
        self._waiting: OrderedDict[int, tuple[int, Belief]] = OrderedDict()
        self._judged = self._right = self._unknown = 0
        self._errors_m: list[float] = []
        self._untracked: list[Break] = []
        self._sure_and_wrong: list[Break] = []
        self._last: tuple[Belief, PoseError] | None = None

    def truth(self, stamp_ns: int, pose: PoseTuple) -> None:
        """Where the robot was when it took a scan."""
        self._truths[stamp_ns] = pose
        while len(self._truths) > _KEPT_TRUTHS:
            self._truths.popitem(last=False)
        if (held := self._waiting.pop(stamp_ns, None)) is not None:
            self._judge(*held, pose)

    def take(self, at_ns: int, belief: Belief) -> None:
        """A belief was heard; its truth may still be on its way."""
        pose = self._truths.get(belief.stamp_ns)
        if pose is not None:
            self._judge(at_ns, belief, pose)
            return
        self._waiting[belief.stamp_ns] = at_ns, belief
        while len(self._waiting) > 64:
            self._waiting.popitem(last=False)
            self._unknown += 1

    def verdicts(self) -> list[Verdict]:
        """On the nearest place, and on what was believed for certain."""
        share = self._right / self._judged if self._judged else 0.0
        ordered = sorted(self._errors_m)
        median_m = ordered[len(ordered) // 2] if ordered else math.nan
        p99_m = ordered[int(0.99 * (len(ordered) - 1))] if ordered else math.nan
        return [
            Verdict(
                promise="one of the places is where the robot is",
                target=f">= {TRUTH_TRACKED_SHARE:.0%} of beliefs",
                measured=f"{share:.2%} of {self._judged:,}; {median_m:.2f} m off "
                f"(99 %: {p99_m:.2f} m)",
                kept=self._judged > 0 and share >= TRUTH_TRACKED_SHARE,
                breaks=tuple(self._untracked[:KEPT_BREAKS]),
                figures={"share": share, "median_m": median_m, "p99_m": p99_m},
            ),
            Verdict(
                promise="no belief is sure of a wrong place",
                target="none",
                measured=f"{len(self._sure_and_wrong)} of {self._judged:,}",
                kept=self._judged > 0 and not self._sure_and_wrong,
                breaks=tuple(self._sure_and_wrong[:KEPT_BREAKS]),
                figures={"wrong": len(self._sure_and_wrong), "unknown": self._unknown},
            ),
        ]

    @property
    def unknown(self) -> int:
        """Beliefs whose truth was never heard."""
        return self._unknown

    def localized(self) -> Verdict:
        """Whether the last belief was sure of the right place; no promise where rooms are alike."""
        measured, right = "no belief", False
        if self._last is not None:
            belief, error = self._last
            right = belief.state == "localized" and error.right
            measured = f"{belief.state}, {error.distance_m:.2f} m off"
        return Verdict(
            promise="the robot is localized", target="in the end", measured=measured, kept=right
        )

    def _judge(self, at_ns: int, belief: Belief, truth: PoseTuple) -> None:
        if not belief.hypotheses:
            return
        errors = [pose_error(place.mean, truth) for place in belief.hypotheses]
        nearest: PoseError = min(errors, key=lambda error: (not error.right, error.distance_m))
        self._judged += 1
        self._right += nearest.right
        self._errors_m.append(nearest.distance_m)
        if not nearest.right:
            what = f"the nearest place is {nearest.distance_m:.1f} m off at step {belief.step}"
            self._untracked.append(Break(at_ns, what))
        self._last = belief, errors[0]
        sure = belief.hypotheses[0].probability >= CONFIDENT_PROBABILITY
        if sure and not errors[0].right:
            what = f"{errors[0].distance_m:.1f} m off at step {belief.step}"
            self._sure_and_wrong.append(Break(at_ns, what))
