"""Promises about the pose that anybody can ask for: it is answered, and its age is the truth."""

from dataclasses import dataclass

from protocol.answers import PoseAnswer
from soak_test.availability import Availability
from soak_test.verdict import KEPT_BREAKS, Break, Verdict

ANSWERED_SHARE = 0.999
ALLOWANCE_S = 0.25
"""What a loaded machine may need between the robot's clock and the coordinator's."""


@dataclass(frozen=True)
class Question:
    """One question for the pose, and what came of it."""

    asked_ns: int
    closed_ns: int
    """When the answer arrived, or was no longer waited for."""
    answer: PoseAnswer | None


class Answered:
    """Counts questions; those without an answer are judged at the end, when excuses are known."""

    def __init__(self, availability: Availability) -> None:
        self._availability = availability
        self._asked = 0
        self._unanswered: list[Question] = []

    def on_question(self, question: Question) -> None:
        """A question is closed."""
        self._asked += 1
        if question.answer is None:
            self._unanswered.append(question)

    def verdict(self) -> Verdict:
        """The share that was answered while a coordinator was up."""
        broken = [
            question
            for question in self._unanswered
            if self._availability.reachable(question.asked_ns, question.closed_ns)
        ]
        counted = self._asked - len(self._unanswered) + len(broken)
        share = 1.0 - len(broken) / counted if counted else 0.0
        over_all = 1.0 - len(self._unanswered) / self._asked if self._asked else 0.0
        breaks = [
            Break(q.asked_ns, f"no answer within {(q.closed_ns - q.asked_ns) / 1e9:.2f} s")
            for q in broken[:KEPT_BREAKS]
        ]
        return Verdict(
            promise="the pose is answered while a coordinator is up",
            target=f">= {ANSWERED_SHARE:.1%}",
            measured=f"{share:.2%} of {counted:,} ({over_all:.1%} with all outages)",
            kept=counted > 0 and share >= ANSWERED_SHARE,
            breaks=tuple(breaks),
            figures={"share": share, "share_with_outages": over_all, "asked": self._asked},
        )


class Ages:
    """Compares what answers say of their age with the robot's stamps; all share one clock.

    The answer was made between question and arrival, so its data had an age between
    `asked - stamp` and `arrived - stamp`; only what is outside for certain counts.
    """

    def __init__(self, stale_after_s: float) -> None:
        self._stale_after_s = stale_after_s
        self._fresh = self._judged = 0
        self._oldest_fresh_s = self._worst_s = 0.0
        self._wrong_fresh: list[Break] = []
        self._dishonest: list[Break] = []

    def on_question(self, question: Question) -> None:
        """A question is closed."""
        answer = question.answer
        if answer is None or answer.freshness == "none":
            return
        self._judged += 1
        least_s = (question.asked_ns - answer.stamp_ns) / 1e9
        most_s = (question.closed_ns - answer.stamp_ns) / 1e9
        if answer.freshness == "fresh":
            self._fresh += 1
            self._oldest_fresh_s = max(self._oldest_fresh_s, least_s)
            if least_s > self._stale_after_s + ALLOWANCE_S:
                what = f"fresh, but its data is {least_s:.2f} s old"
                self._wrong_fresh.append(Break(question.asked_ns, what))
        off_s = max(least_s - answer.age_s, answer.age_s - most_s, 0.0)
        self._worst_s = max(self._worst_s, off_s)
        if off_s > ALLOWANCE_S:
            what = f"says {answer.age_s:.2f} s, is {least_s:.2f} to {most_s:.2f} s"
            self._dishonest.append(Break(question.asked_ns, what))

    def verdicts(self) -> list[Verdict]:
        """On what is called fresh, and on ages."""
        return [
            Verdict(
                promise="no pose is called fresh whose data is old",
                target=f"none over {self._stale_after_s + ALLOWANCE_S:g} s",
                measured=f"{len(self._wrong_fresh)} of {self._fresh:,}; oldest "
                f"{self._oldest_fresh_s:.2f} s",
                kept=self._fresh > 0 and not self._wrong_fresh,
                breaks=tuple(self._wrong_fresh[:KEPT_BREAKS]),
                figures={"wrong": len(self._wrong_fresh), "oldest_s": self._oldest_fresh_s},
            ),
            Verdict(
                promise="a pose says how old its data is",
                target=f"within {ALLOWANCE_S:g} s",
                measured=f"{len(self._dishonest)} of {self._judged:,} not, worst "
                f"{self._worst_s:.2f} s off",
                kept=self._judged > 0 and not self._dishonest,
                breaks=tuple(self._dishonest[:KEPT_BREAKS]),
                figures={
                    "wrong": len(self._dishonest),
                    "worst_s": self._worst_s,
                },
            ),
        ]
