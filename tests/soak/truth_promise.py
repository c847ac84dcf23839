"""Promise: the true place and its look-alikes are kept, and no wrong place is sure."""

import math
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from evaluation.pose_error import CONFIDENT_PROBABILITY, pose_error
from protocol.answers import Belief
from protocol.job_events import Ended, JobEvents, event_text
from protocol.message import PoseTuple
from tests.soak.promise import (
    BACK_WITHIN_S,
    KEPT_BREAKS,
    NO_COORDINATOR,
    NO_NETWORK,
    Break,
    Outages,
    Verdict,
)

SUM_WITHIN = 1e-9
FOUND_WITHIN_S = 60.0
"""Time after a kidnapping in which a search must find all look-alike places [s]."""
_WAITING_BELIEFS, _KEPT_TRUTHS, _KEPT_ENDS = 64, 4096, 200


@dataclass(frozen=True)
class _Truth:
    map_from_robot: PoseTuple
    kidnapped: int
    """Number of kidnappings until then."""


class TruthHeld:
    """Told true poses, beliefs and job events in any order.

    A place is held while a cluster is within 1 m and 20 degrees of it. Judged from the first
    belief that holds all places on. Left out: beliefs to which no worker has reported, and the
    time in which a kidnapped robot is looked for, which has a bound of its own.

    Args:
        outages: give a search more time.
        places_of: all poses at which a robot sees the same as at its true pose.
    """

    def __init__(
        self, outages: Outages, places_of: Callable[[PoseTuple], Sequence[PoseTuple]]
    ) -> None:
        self._outages, self._places_of = outages, places_of
        self._truths: OrderedDict[int, _Truth] = OrderedDict()
        self._waiting: OrderedDict[int, tuple[int, Belief]] = OrderedDict()
        self._ends: OrderedDict[str, str] = OrderedDict()
        self._holders: list[int] = []
        self._kidnapped = 0
        self._missed_since_ns: int | None = None
        self._found_s: list[float] = []
        self._beliefs = self._short = self._sure_and_wrong = self._unreported = 0
        self._errors_m: list[float] = []
        self._worst_sum = 0.0
        self._breaks: list[Break] = []

    @property
    def is_complete(self) -> bool:
        """Whether one belief had all places: the first search is over."""
        return bool(self._holders)

    def on_events(self, events: JobEvents) -> None:
        for numbered in events.events:
            if isinstance(numbered.event, Ended):
                self._ends[numbered.event.job_id] = event_text(numbered.event)
        while len(self._ends) > _KEPT_ENDS:
            self._ends.popitem(last=False)

    def on_truth(self, stamp_ns: int, map_from_robot: PoseTuple, kidnapped: int) -> None:
        """Take the true pose of a scan."""
        self._truths[stamp_ns] = truth = _Truth(map_from_robot, kidnapped)
        while len(self._truths) > _KEPT_TRUTHS:
            self._truths.popitem(last=False)
        if (waiting := self._waiting.pop(stamp_ns, None)) is not None:
            self._judge(*waiting, truth)

    def on_belief(self, at_ns: int, belief: Belief) -> None:
        """Take a belief; it is queued until its scan's true pose arrives."""
        if (truth := self._truths.get(belief.stamp_ns)) is not None:
            self._judge(at_ns, belief, truth)
            return
        self._waiting[belief.stamp_ns] = at_ns, belief
        while len(self._waiting) > _WAITING_BELIEFS:
            _, (at_ns, lost) = self._waiting.popitem(last=False)
            self._breaks.append(Break(at_ns, f"belief of step {lost.step}: of no scan of ours"))

    def verdict(self, now_ns: int) -> Verdict:
        self._judge_search(now_ns)
        ordered = sorted(self._errors_m)
        p99_m = ordered[int(0.99 * (len(ordered) - 1))] if ordered else math.nan
        return Verdict(
            promise="the true places are held, no wrong one is sure",
            target="always; kidnapped: within 60 s",
            measured=f"not in {self._short:,} of {self._beliefs:,}; {self._sure_and_wrong} sure and"
            f" wrong; 99 % within {p99_m:.2f} m; found again {len(self._found_s)} times in"
            f" {max(self._found_s, default=0.0):.1f} s; {self._unreported} left out",
            kept=self._beliefs > 0 and not self._breaks,
            breaks=tuple(self._breaks[:KEPT_BREAKS]),
            figures={
                "beliefs": self._beliefs,
                "short": self._short,
                "sure_and_wrong": self._sure_and_wrong,
                "p99_m": p99_m,
                "found": len(self._found_s),
                "found_longest_s": max(self._found_s, default=0.0),
                "worst_sum": self._worst_sum,
                "unreported": self._unreported,
            },
        )

    def _judge(self, at_ns: int, belief: Belief, truth: _Truth) -> None:
        places = belief.hypotheses
        if not places:
            return
        if all(f"c{place.cluster}" in belief.missing for place in places):
            self._unreported += 1
            return
        copies = self._places_of(truth.map_from_robot)
        holders = [_holder(belief, copy) for copy in copies]
        held = [holder for holder in holders if holder is not None]
        if truth.kidnapped > self._kidnapped:
            self._kidnapped, self._missed_since_ns = truth.kidnapped, at_ns
        if self._missed_since_ns is not None:
            self._judge_search(at_ns)
            if len(held) < len(copies):
                return
            self._found_s.append((at_ns - self._missed_since_ns) / 1e9)
            self._missed_since_ns = None
        if not self.is_complete and len(held) < len(copies):
            return
        self._beliefs += 1
        self._judge_sum(at_ns, belief)
        self._judge_places(at_ns, belief, truth.map_from_robot, copies, holders)

    def _judge_sum(self, at_ns: int, belief: Belief) -> None:
        here = math.fsum(place.probability for place in belief.hypotheses)
        off = abs(here + belief.elsewhere_probability - 1.0)
        self._worst_sum = max(self._worst_sum, off)
        if not off <= SUM_WITHIN:
            self._breaks.append(Break(at_ns, f"step {belief.step}: the sum is off by {off:.1e}"))

    def _judge_places(
        self,
        at_ns: int,
        belief: Belief,
        truth: PoseTuple,
        copies: Sequence[PoseTuple],
        holders: Sequence[int | None],
    ) -> None:
        first = belief.hypotheses[0]
        error = pose_error(first.mean, truth)
        self._errors_m.append(
            min(pose_error(p.mean, copy).distance_m for p in belief.hypotheses for copy in copies)
        )
        if first.probability >= CONFIDENT_PROBABILITY and not error.right:
            self._sure_and_wrong += 1
            what = f"step {belief.step}: sure and {error.distance_m:.1f} m off"
            self._breaks.append(Break(at_ns, what))
        lost = [room for room, holder in enumerate(holders) if holder is None]
        self._short += bool(lost)
        for room in lost if self._holders else ():
            if self._holders[room] >= 0:
                cause = self._cause(self._holders[room])
                what = f"step {belief.step}: place {room} is lost: {cause}"
                self._breaks.append(Break(at_ns, what))
        self._holders = [-1 if holder is None else holder for holder in holders]

    def _cause(self, cluster: int) -> str:
        return self._ends.get(f"c{cluster}", f"c{cluster} has strayed, or no event says why")

    def _judge_search(self, now_ns: int) -> None:
        """Record once that a kidnapped robot was not found in time."""
        since_ns = self._missed_since_ns
        if since_ns is None or self._breaks[-1:] == [Break(since_ns, _NOT_FOUND)]:
            return
        disturbed = self._outages.excuse(NO_COORDINATOR | NO_NETWORK, since_ns, now_ns)
        allowed_s = FOUND_WITHIN_S + (BACK_WITHIN_S if disturbed else 0.0)
        if now_ns - since_ns > allowed_s * 1e9:
            self._breaks.append(Break(since_ns, _NOT_FOUND))


_NOT_FOUND = f"the robot was kidnapped and not found within {FOUND_WITHIN_S:g} s"


def _holder(belief: Belief, copy: PoseTuple) -> int | None:
    """Return the most probable cluster at a pose, or None; places of a search do not count."""
    at_pose = (p.cluster for p in belief.hypotheses if pose_error(p.mean, copy).right)
    return next((cluster for cluster in at_pose if cluster >= 0), None)
