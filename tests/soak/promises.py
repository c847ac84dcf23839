"""The promises on poses, steps and places, and the outages that excuse a broken one."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

from clustermcl.evaluation.measures import CONFIDENT_PROBABILITY, pose_error
from clustermcl.protocol.answers import Belief, PoseAnswer
from clustermcl.protocol.message import PoseTuple
from tests.soak.schedule import DoneFault, Kind

BACK_WITHIN_S = 6.0
"""Recovery time after a fault: a process starts in 1 to 2 s, a link reconnects within 1 s, and a
new coordinator listens before it leads."""
WORKERS_BACK_WITHIN_S = 8.0
"""Workers take longer to start than a coordinator."""
REPEATED_WITHIN_S = 30.0
"""After an outage of the coordinator its successor may publish a belief again [s]."""
ANSWERED_SHARE = 0.999
ALLOWANCE_S = 0.25
"""Delay allowed on a loaded machine between the robot's stamp and the coordinator's clock."""
FOUND_WITHIN_S = 60.0
"""Time after a kidnapping in which a search must find all look-alike places [s]."""
NO_COORDINATOR = frozenset({Kind.COORDINATOR_KILLED, Kind.COORDINATOR_FROZEN})
NO_NETWORK = frozenset({Kind.ROUTER_KILLED, Kind.ROUTER_FROZEN, Kind.SLOW_NETWORK})
NO_WORKERS = frozenset({Kind.ALL_WORKERS_KILLED})
_REMEMBERED = 4096
"""Scans and true poses that are kept for their belief; it comes within seconds."""


@dataclass(frozen=True)
class Break:
    at_ns: int
    """0: no particular time."""
    what: str


@dataclass(frozen=True, kw_only=True)
class Verdict:
    promise: str
    kept: bool | None
    """None: not enough data."""
    figures: dict[str, float]
    breaks: Sequence[Break] = ()


class Outages:
    """The injected faults and the violations that they excuse."""

    def __init__(self) -> None:
        self.faults: list[DoneFault] = []

    def excuse(
        self, kinds: Collection[Kind], begin_ns: int, end_ns: int, after_s: float = BACK_WITHIN_S
    ) -> bool:
        """Return whether a fault of these kinds, or its consequences, overlaps a time."""
        return any(
            fault.kind in kinds
            and fault.at_ns <= end_ns
            and begin_ns <= fault.until_ns + after_s * 1e9
            for fault in self.faults
        )


@dataclass(frozen=True)
class Question:
    asked_ns: int
    closed_ns: int
    """Time of the answer or of the time-out."""
    answer: PoseAnswer | None


class Answered:
    """Promise: pose queries are answered, except during outages."""

    def __init__(self, outages: Outages) -> None:
        self._outages = outages
        self._asked = 0
        self._unanswered: list[Question] = []

    def on_question(self, question: Question) -> None:
        self._asked += 1
        if question.answer is None:
            self._unanswered.append(question)

    def verdict(self) -> Verdict:
        kinds = NO_COORDINATOR | NO_NETWORK
        breaks = [
            Break(q.asked_ns, f"no answer within {(q.closed_ns - q.asked_ns) / 1e9:.2f} s")
            for q in self._unanswered
            if not self._outages.excuse(kinds, q.asked_ns, q.closed_ns)
        ]
        counted = self._asked - len(self._unanswered) + len(breaks)
        share = 1.0 - len(breaks) / counted if counted else 0.0
        with_outages = 1.0 - len(self._unanswered) / self._asked if self._asked else 0.0
        return Verdict(
            promise="the pose is answered",
            kept=counted > 0 and share >= ANSWERED_SHARE,
            breaks=breaks,
            figures={"share": share, "share_with_outages": with_outages, "asked": self._asked},
        )


class AgeTrue:
    """Promise: an answer's age is true, and `fresh` means younger than `stale_after_s`.

    Robot and coordinator share one clock here. An answer is made between query and arrival, so
    its data is between `asked - stamp` and `closed - stamp` old.
    """

    def __init__(self, stale_after_s: float) -> None:
        self._stale_after_s = stale_after_s
        self._checked = self._wrong_fresh = 0
        self._worst_s = 0.0
        self._breaks: list[Break] = []

    def on_question(self, question: Question) -> None:
        answer = question.answer
        if answer is None or answer.freshness == "none":
            return
        self._checked += 1
        least_s = (question.asked_ns - answer.stamp_ns) / 1e9
        most_s = (question.closed_ns - answer.stamp_ns) / 1e9
        if answer.freshness == "fresh" and least_s > self._stale_after_s + ALLOWANCE_S:
            self._wrong_fresh += 1
            self._breaks.append(Break(question.asked_ns, f"fresh, but {least_s:.2f} s old"))
        off_s = max(least_s - answer.age_s, answer.age_s - most_s, 0.0)
        self._worst_s = max(self._worst_s, off_s)
        if off_s > ALLOWANCE_S:
            what = f"age {answer.age_s:.2f} s, true {least_s:.2f} to {most_s:.2f} s"
            self._breaks.append(Break(question.asked_ns, what))

    def verdict(self) -> Verdict:
        wrong = len(self._breaks)
        return Verdict(
            promise="the pose's age is true",
            kept=self._checked > 0 and not wrong,
            breaks=self._breaks,
            figures={
                "checked": self._checked,
                "wrong": wrong,
                "wrong_fresh": self._wrong_fresh,
                "worst_s": self._worst_s,
            },
        )


class StepsOnce:
    """Promise: each step has one belief, in time, with an excuse for each that is missing.

    Excused are steps while the network was down, or while there was no coordinator or no worker.
    A coordinator that takes over may publish a belief again.
    """

    def __init__(self, outages: Outages, longest_s: float) -> None:
        self._outages, self._longest_s = outages, longest_s
        self._scans: dict[int, int] = {}
        self._seen: set[int] = set()
        self._last: tuple[int, int] | None = None
        self._lost = self._excused = self._repeated = 0
        self._delays_s: list[float] = []
        self._breaks: list[Break] = []

    def on_scan(self, at_ns: int, step: int) -> None:
        self._scans.setdefault(step, at_ns)
        _forget_oldest(self._scans)

    def on_belief(self, at_ns: int, step: int) -> None:
        if step in self._seen:
            self._repeated += 1
            if not self._outages.excuse(NO_COORDINATOR, at_ns, at_ns, REPEATED_WITHIN_S):
                self._breaks.append(Break(at_ns, f"step {step} again"))
            return
        self._seen.add(step)
        if self._last is not None and step > self._last[0] + 1:
            self._on_gap(self._last[1], at_ns, step - self._last[0] - 1, step)
        self._last = max(self._last or (-1, 0), (step, at_ns))
        sent_ns = self._scans.pop(step, None)
        if sent_ns is not None and not self._is_excused(sent_ns, at_ns):
            self._delays_s.append(delay_s := (at_ns - sent_ns) / 1e9)
            if delay_s > self._longest_s:
                self._breaks.append(Break(at_ns, f"step {step} took {delay_s:.2f} s"))

    def verdict(self) -> Verdict:
        ordered, steps = sorted(self._delays_s), len(self._seen)
        return Verdict(
            promise="each step is decided once",
            kept=steps > 0 and not self._breaks,
            breaks=self._breaks,
            figures={
                "steps": steps, "lost": self._lost, "lost_in_outages": self._excused,
                "repeated": self._repeated, "median_s": _quantile(ordered, 0.5),
                "p99_s": _quantile(ordered, 0.99), "longest_s": _quantile(ordered, 1.0),
            },
        )  # fmt: skip

    def _is_excused(self, begin_ns: int, end_ns: int) -> bool:
        excuse = self._outages.excuse
        return excuse(NO_COORDINATOR | NO_NETWORK, begin_ns, end_ns) or excuse(
            NO_WORKERS, begin_ns, end_ns, WORKERS_BACK_WITHIN_S
        )

    def _on_gap(self, begin_ns: int, end_ns: int, missing: int, before: int) -> None:
        if self._is_excused(begin_ns, end_ns):
            self._excused += missing
            return
        self._lost += missing
        self._breaks.append(Break(end_ns, f"{missing} steps before step {before} are lost"))


class TruthHeld:
    """Promise: the true place and its look-alikes are held, and no wrong place is sure.

    A place is held while a cluster is within 1 m and 20 degrees of it, from the first belief on
    that holds all places. Left out: beliefs to which no worker has reported, and the search for a
    kidnapped robot, which has a bound of its own.
    """

    def __init__(
        self, outages: Outages, places_of: Callable[[PoseTuple], Sequence[PoseTuple]]
    ) -> None:
        self._outages, self._places_of = outages, places_of
        self._truths: dict[int, tuple[PoseTuple, int]] = {}
        self._held: list[bool] = []
        self._kidnapped = 0
        self._missed_since_ns: int | None = None
        self._found_s: list[float] = []
        self._beliefs = self._short = self._sure_and_wrong = self._unreported = 0
        self._errors_m: list[float] = []
        self._breaks: list[Break] = []

    @property
    def is_complete(self) -> bool:
        """Whether one belief had all places: the first search is over."""
        return bool(self._held)

    def on_truth(self, stamp_ns: int, map_from_robot: PoseTuple, kidnapped: int) -> None:
        """Take the true pose of a scan, and the number of kidnappings until then."""
        self._truths[stamp_ns] = map_from_robot, kidnapped
        _forget_oldest(self._truths)

    def on_belief(self, at_ns: int, belief: Belief) -> None:
        """Check a belief, at the true pose that the robot published before the scan."""
        if (truth := self._truths.get(belief.stamp_ns)) is not None:
            self._check(at_ns, belief, *truth)
        else:
            self._unreported += 1

    def verdict(self, now_ns: int) -> Verdict:
        self._check_search(now_ns)
        return Verdict(
            promise="the true places are held, no wrong one is sure",
            kept=self._beliefs > 0 and not self._breaks,
            breaks=self._breaks,
            figures={
                "beliefs": self._beliefs, "short": self._short,
                "sure_and_wrong": self._sure_and_wrong,
                "p99_m": _quantile(sorted(self._errors_m), 0.99),
                "found": len(self._found_s), "found_longest_s": max(self._found_s, default=0.0),
                "unreported": self._unreported,
            },
        )  # fmt: skip

    def _check(self, at_ns: int, belief: Belief, truth: PoseTuple, kidnapped: int) -> None:
        places = belief.hypotheses
        if not places:
            return
        if all(f"c{place.cluster}" in belief.missing for place in places):
            self._unreported += 1
            return
        copies = self._places_of(truth)
        held = [_is_held(belief, copy) for copy in copies]
        if kidnapped > self._kidnapped:
            self._kidnapped, self._missed_since_ns = kidnapped, at_ns
        if self._missed_since_ns is not None:
            self._check_search(at_ns)
            if not all(held):
                return
            self._found_s.append((at_ns - self._missed_since_ns) / 1e9)
            self._missed_since_ns = None
        if not self.is_complete and not all(held):
            return
        self._beliefs += 1
        self._errors_m.append(
            min(pose_error(p.pose, copy).distance_m for p in places for copy in copies)
        )
        self._short += not all(held)
        lost = [room for room, before in enumerate(self._held) if before and not held[room]]
        what = [f"place {room} is lost" for room in lost]
        error = pose_error(places[0].pose, truth)
        if places[0].probability >= CONFIDENT_PROBABILITY and not error.right:
            self._sure_and_wrong += 1
            what.append(f"sure and {error.distance_m:.1f} m off")
        self._breaks += [Break(at_ns, f"step {belief.step}: {one}") for one in what]
        self._held = held

    def _check_search(self, now_ns: int) -> None:
        since_ns = self._missed_since_ns
        if since_ns is None:
            return
        late = Break(since_ns, f"kidnapped and not found within {FOUND_WITHIN_S:g} s")
        disturbed = self._outages.excuse(NO_COORDINATOR | NO_NETWORK, since_ns, now_ns)
        allowed_s = FOUND_WITHIN_S + (BACK_WITHIN_S if disturbed else 0.0)
        if now_ns - since_ns > allowed_s * 1e9 and late not in self._breaks:
            self._breaks.append(late)


def _is_held(belief: Belief, copy: PoseTuple) -> bool:
    """Return whether the most probable hypothesis at a pose is a cluster, not of a search."""
    at_pose = (p.cluster >= 0 for p in belief.hypotheses if pose_error(p.pose, copy).right)
    return any(at_pose)


def _quantile(ordered: Sequence[float], share: float) -> float:
    return ordered[int(share * (len(ordered) - 1))] if ordered else 0.0


def _forget_oldest(kept: dict[int, Any]) -> None:
    while len(kept) > _REMEMBERED:
        del kept[next(iter(kept))]
