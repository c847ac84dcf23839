"""What is noted of one step of a run, to compute every number of the run from afterwards."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from evaluation.pose_error import CONFIDENT_PROBABILITY, PoseError, pose_error
from protocol.answers import Hypothesis, State
from protocol.message import PoseTuple


@dataclass(frozen=True, slots=True)
class StepFacts:
    """One step."""

    update: int
    """Its place among the steps of the run; the first is 1."""
    stamp_ns: int
    """Time of its scan."""
    state: State
    probability: float
    """Of the estimate, the most probable place; 0 without one."""
    error: PoseError | None
    """Of the estimate; None without one, as while the first search still runs."""
    told: tuple[tuple[float, bool], ...]
    """Of every place told, also by a first search: its probability and whether it is right."""
    elsewhere: float | None
    """Probability that the robot is at none of the places; None: the belief does not say."""
    copies: tuple[float | None, ...]
    """For the true pose and each symmetric copy of it: the probability of all places that are
    right about it together; None where there is no such place. Empty: nobody knows the true
    pose."""
    off_map: float = 0.0
    """Probability that the robot is not on the map."""

    @property
    def judged(self) -> bool:
        """The true pose is known. Of a step that is not judged only number, time and state are."""
        return bool(self.copies)

    @property
    def claims(self) -> tuple[tuple[float, bool], ...]:
        """Of every place held: its probability and whether it is right."""
        return () if self.state == "searching" else self.told

    @property
    def truth_told(self) -> float:
        """Probability of all right places together, also of those a first search tells."""
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
        """Some place is right."""
        return self.copies[0] is not None

    @property
    def all_tracked(self) -> bool:
        """For the truth and every symmetric copy of it there is some place."""
        return None not in self.copies

    @property
    def leader(self) -> int | None:
        """The copy with the highest probability; None if there is a place for none."""
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
    """Note one step.

    Args:
        update: its place among the steps of the run.
        stamp_ns: time of its scan.
        state: of the system after it.
        hypotheses: the places held after it, most probable first.
        copies: the true pose, then its symmetric copies; empty where nobody knows.
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
