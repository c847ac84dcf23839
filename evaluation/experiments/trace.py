"""One run step by step, kept for the plots."""

from dataclasses import dataclass, field

from evaluation.experiments.symmetry import Point
from evaluation.pose_error import CONFIDENT_PROBABILITY
from protocol.answers import Hypothesis
from protocol.message import PoseTuple

MOST_PLACES = 12


@dataclass(frozen=True, slots=True)
class TracePlace:
    """One place after a step."""

    cluster: int
    probability: float
    position: Point


@dataclass(frozen=True, slots=True)
class TraceStep:
    """One judged step."""

    update: int
    truth: PoseTuple
    right: bool
    truth_probability: float
    """Probability of all right places together."""
    places: tuple[TracePlace, ...]
    """The most probable ones, best first."""

    @property
    def confidently_wrong(self) -> bool:
        """The estimate is wrong and has a probability of 0.9 or more."""
        sure = bool(self.places) and self.places[0].probability >= CONFIDENT_PROBABILITY
        return sure and not self.right


@dataclass
class Trace:
    """The judged steps of one run."""

    seed: int
    steps: list[TraceStep] = field(default_factory=list)

    @property
    def finding(self) -> str:
        """One line on the result of a run that has steps."""
        held = sum(step.truth_probability for step in self.steps) / len(self.steps)
        wrong = sum(step.confidently_wrong for step in self.steps) / len(self.steps)
        given = f"the right place was given {held:.0%}"
        return f"{given}, sure of a wrong one on {wrong:.0%} of all updates"


def places_of(hypotheses: tuple[Hypothesis, ...]) -> tuple[TracePlace, ...]:
    """Return the most probable places for the plots."""
    return tuple(
        TracePlace(place.cluster, place.probability, (place.mean[0], place.mean[1]))
        for place in hypotheses[:MOST_PLACES]
    )
