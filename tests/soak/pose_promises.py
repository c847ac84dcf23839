"""Promises about pose queries: they are answered, and the age in the answer is true."""

from dataclasses import dataclass

from protocol.answers import PoseAnswer
from tests.soak.promise import KEPT_BREAKS, NO_COORDINATOR, NO_NETWORK, Break, Outages, Verdict

ANSWERED_SHARE = 0.999
ALLOWANCE_S = 0.25
"""Delay allowed on a loaded machine between the robot's stamp and the coordinator's clock."""


@dataclass(frozen=True)
class Question:
    """One query for the pose and its outcome."""

    asked_ns: int
    closed_ns: int
    """Time of the answer or of the time-out."""
    answer: PoseAnswer | None


class Answered:
    """Promise: pose queries are answered, except during outages.

    Args:
        outages: evaluated by the verdict, because a fault is recorded after the query.
    """

    def __init__(self, outages: Outages) -> None:
        self._outages = outages
        self._asked = 0
        self._unanswered: list[Question] = []
        self._last_answer_ns = 0
        self._longest_s = 0.0

    def on_question(self, question: Question) -> None:
        self._asked += 1
        if question.answer is None:
            self._unanswered.append(question)
            return
        silent_ns = question.closed_ns - (self._last_answer_ns or question.closed_ns)
        self._longest_s = max(self._longest_s, silent_ns / 1e9)
        self._last_answer_ns = question.closed_ns

    def verdict(self) -> Verdict:
        """Return the verdict on the share answered outside outages of coordinator and network."""
        kinds = NO_COORDINATOR | NO_NETWORK
        broken = [
            question
            for question in self._unanswered
            if not self._outages.excuse(kinds, question.asked_ns, question.closed_ns)
        ]
        counted = self._asked - len(self._unanswered) + len(broken)
        share = 1.0 - len(broken) / counted if counted else 0.0
        with_outages = 1.0 - len(self._unanswered) / self._asked if self._asked else 0.0
        return Verdict(
            promise="the pose is answered",
            target=f">= {ANSWERED_SHARE:.1%} outside outages",
            measured=f"{share:.2%} of {counted:,} ({with_outages:.2%} with outages); "
            f"longest silence {self._longest_s:.1f} s",
            kept=counted > 0 and share >= ANSWERED_SHARE,
            breaks=tuple(
                Break(q.asked_ns, f"no answer within {(q.closed_ns - q.asked_ns) / 1e9:.2f} s")
                for q in broken[:KEPT_BREAKS]
            ),
            figures={
                "share": share,
                "share_with_outages": with_outages,
                "asked": self._asked,
                "longest_silence_s": self._longest_s,
            },
        )


class AgeTrue:
    """Promise: an answer's age is true, and `fresh` means younger than `stale_after_s`.

    Robot and coordinator share one clock here. An answer is made between query and arrival, so
    its data is between `asked - stamp` and `closed - stamp` old.
    """

    def __init__(self, stale_after_s: float) -> None:
        self._stale_after_s = stale_after_s
        self._judged = self._wrong_fresh = 0
        self._worst_s = 0.0
        self._breaks: list[Break] = []

    def on_question(self, question: Question) -> None:
        answer = question.answer
        if answer is None or answer.freshness == "none":
            return
        self._judged += 1
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
        return Verdict(
            promise="the pose's age is true",
            target=f"within {ALLOWANCE_S:g} s",
            measured=f"{len(self._breaks)} of {self._judged:,} wrong; worst {self._worst_s:.2f} s",
            kept=self._judged > 0 and not self._breaks,
            breaks=tuple(self._breaks[:KEPT_BREAKS]),
            figures={
                "wrong": len(self._breaks),
                "wrong_fresh": self._wrong_fresh,
                "worst_s": self._worst_s,
            },
        )
