"""One run step by step, kept for the plots."""

from dataclasses import dataclass, field

from evaluation.experiments.symmetry import Point
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


@dataclass
class Trace:
    """The judged steps of one run."""

    seed: int
    steps: list[TraceStep] = field(default_factory=list)


def places_of(hypotheses: tuple[Hypothesis, ...]) -> tuple[TracePlace, ...]:
    """Return the most probable places for the plots."""
    return tuple(
        TracePlace(place.cluster, place.probability, (place.mean[0], place.mean[1]))
        for place in hypotheses[:MOST_PLACES]
    )
