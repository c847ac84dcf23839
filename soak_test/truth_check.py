"""Promises about the truth: it is among the places, and nothing else is believed for certain."""

import math

from evaluation.judge import CONFIDENT_PROBABILITY, PoseError, pose_error
from protocol.answers import Belief
from soak_test.true_poses import JudgedBelief
from soak_test.verdict import KEPT_BREAKS, Break, Verdict

TRUTH_TRACKED_SHARE = 0.99


def truth_held(judged: JudgedBelief) -> bool:
    """Whether one of the places is where the robot is."""
    return any(pose_error(place.mean, judged.truth).right for place in judged.belief.hypotheses)


class Truth:
    """One of the places is where the robot is, and nothing else is believed for certain."""

    def __init__(self) -> None:
        self._judged = self._right = self._blind = 0
        self._errors_m: list[float] = []
        self._untracked: list[Break] = []
        self._sure_and_wrong: list[Break] = []
        self._last: tuple[Belief, PoseError] | None = None

    def judge(self, judged: JudgedBelief) -> None:
        """A belief was heard whose truth is known."""
        if not judged.belief.hypotheses:
            return
        if judged.blind:
            self._blind += 1
            return
        at_ns, belief, truth = judged.at_ns, judged.belief, judged.truth
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
                f"(99 %: {p99_m:.2f} m); {self._blind} blind",
                kept=self._judged > 0 and share >= TRUTH_TRACKED_SHARE,
                breaks=tuple(self._untracked[:KEPT_BREAKS]),
                figures={
                    "share": share,
                    "median_m": median_m,
                    "p99_m": p99_m,
                    "blind": self._blind,
                },
            ),
            Verdict(
                promise="no belief is sure of a wrong place",
                target="none",
                measured=f"{len(self._sure_and_wrong)} of {self._judged:,}",
                kept=self._judged > 0 and not self._sure_and_wrong,
                breaks=tuple(self._sure_and_wrong[:KEPT_BREAKS]),
                figures={"wrong": len(self._sure_and_wrong)},
            ),
        ]

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
