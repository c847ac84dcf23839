"""The facts recorded of each step, from which the measures of a run are computed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from evaluation.pose_error import CONFIDENT_PROBABILITY, PoseError, pose_error
from protocol.answers import Hypothesis, State
from protocol.message import PoseTuple


@dataclass(frozen=True, slots=True)
class StepFacts:
    """The facts of one step."""

    update: int
    """Number of the step in the run; the first is 1."""
    stamp_ns: int
    """Time of its scan."""
    state: State
    probability: float
    """Probability of the estimate, the most probable place; 0 without an estimate."""
    error: PoseError | None
    """Error of the estimate; None without one, as during the first search."""
    told: tuple[tuple[float, bool], ...]
    """Probability of each reported place, including a first search's, and whether it is right."""
    elsewhere: float | None
    """Probability that the robot is at none of the places; None: not in the belief."""
    copies: tuple[float | None, ...]
    """For the true pose and each symmetric copy: total probability of the places that match it, or
    None if there is none. Empty: the true pose is unknown."""
    off_map: float = 0.0
    """Probability that the robot is not on the map."""

    @property
    def judged(self) -> bool:
        """Whether the true pose is known; if not, only number, time and state are valid."""
        return bool(self.copies)

    @property
    def claims(self) -> tuple[tuple[float, bool], ...]:
        """Probability of each place after the first search, and whether it is right."""
        return () if self.state == "searching" else self.told

    @property
    def truth_told(self) -> float:
        """Probability of all right places together, including a first search's."""
        return math.fsum(probability for probability, right in self.told if right)

    @property
    def right(self) -> bool:
        """The estimate is within 1 m and 20 degrees of the truth."""
        return self.error is not None and self.error.right

    @property
    def confidently_wrong(self) -> bool:
        """The estimate is wrong and has a probability of 0.9 or more."""
        return not self.right and self.probability >= CONFIDENT_PROBABILITY

    @property
    def sure_and_right(self) -> bool:
        """The estimate is right and has a probability of 0.9 or more."""
        return self.right and self.probability >= CONFIDENT_PROBABILITY

    @property
    def tracked(self) -> bool:
        """Whether some place is right."""
        return self.copies[0] is not None

    @property
    def all_tracked(self) -> bool:
        """Whether the true pose and every symmetric copy have a place."""
        return None not in self.copies

    @property
    def leader(self) -> int | None:
        """Index of the most probable copy; None if no copy has a place."""
        held = [(p, -index) for index, p in enumerate(self.copies) if p is not None]
        return -max(held)[1] if held else None


def facts_of(
    update: int,
    stamp_ns: int,
    state: State,
    hypotheses: Sequence[Hypothesis],
    copies: Sequence[PoseTuple],
    elsewhere: float | None = None,
    off_map: float = 0.0,
) -> StepFacts:
    """Record one step.

    Args:
        update: number of the step in the run.
        stamp_ns: time of its scan.
        state: of the system after it.
        hypotheses: the places held after it, most probable first.
        copies: the true pose, then its symmetric copies; empty if unknown.
        elsewhere: probability that it is at none of the places, where the belief has one.
        off_map: probability that the robot is not on the map.
    """
    told = hypotheses if copies else ()
    places = () if state == "searching" else told
    errors = [pose_error(place.mean, copies[0]) for place in told]
    return StepFacts(
        update=update,
        stamp_ns=stamp_ns,
        state=state,
        probability=places[0].probability if places else 0.0,
        error=errors[0] if places else None,
        told=tuple((p.probability, e.right) for p, e in zip(told, errors, strict=True)),
        elsewhere=elsewhere,
        copies=tuple(_probability_at(copy, places) for copy in copies),
        off_map=off_map,
    )


def _probability_at(pose: PoseTuple, places: Sequence[Hypothesis]) -> float | None:
    near = [place.probability for place in places if pose_error(place.mean, pose).right]
    return math.fsum(near) if near else None
