"""The measures of one run; defines each term of the results of `clustermcl evaluate`.

- *Estimate*: the most probable place; none while the first search runs.
- *Right*: within 1 m and 20 degrees of the ground truth.
- *Right for good*: from the first step after which every estimate of the run is right.
- *Scored*: a step with a known true pose. Other steps count only in the number of steps, the
  fractions of states, and the means of "elsewhere" and "off the map".
- *Reported*: the places of a step with their probabilities, also while the first search runs.
- *Tracked*: a step after the first search with a right place, probable or not.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import dropwhile, takewhile
from typing import NamedTuple

import msgspec
import numpy as np

from clustermcl.belief.outcome import Outcome
from clustermcl.filter.poses import heading_distance
from clustermcl.protocol.answers import State
from clustermcl.protocol.message import PoseTuple

RIGHT_WITHIN_M = 1.0
RIGHT_WITHIN_RAD = math.radians(20.0)
CONFIDENT_PROBABILITY = 0.9
LAST_STEPS = 10
"""Number of right estimates at the end of a localized run."""
LEAST_PROBABILITY = 0.001
"""Lower bound of probabilities before the logarithm: a step costs at most 6.9 nat."""


@dataclass(frozen=True, slots=True)
class PoseError:
    """The error of a pose: distance [m] and angle [rad] to the true pose, both non-negative."""

    distance_m: float
    heading_rad: float

    @property
    def right(self) -> bool:
        return self.distance_m <= RIGHT_WITHIN_M and self.heading_rad <= RIGHT_WITHIN_RAD


def pose_error(pose: PoseTuple, truth: PoseTuple) -> PoseError:
    """Return the error of a pose; the heading error is at most pi."""
    return PoseError(math.dist(pose[:2], truth[:2]), float(heading_distance(pose[2], truth[2])))


class ReportedPlace(NamedTuple):
    """A place of a belief, compared with the truth."""

    probability: float
    error: PoseError


@dataclass(frozen=True, slots=True)
class StepFacts:
    """The facts of one step, from which measures are computed."""

    step: int
    """Number of the step in the run, from 0."""
    stamp_ns: int
    state: State
    truth: PoseTuple | None
    reported: tuple[ReportedPlace, ...]
    """Most probable first; empty if the true pose is unknown."""
    elsewhere: float | None
    """Probability that the robot is at none of the places; None: not in the belief."""
    off_map: float

    @property
    def claims(self) -> tuple[ReportedPlace, ...]:
        """The reported places, or none while the first search runs; the first is the estimate."""
        return () if self.state == "searching" else self.reported

    @property
    def error(self) -> PoseError | None:
        return self.claims[0].error if self.claims else None

    @property
    def truth_probability(self) -> float:
        """Probability of all right reported places together."""
        return math.fsum(place.probability for place in self.reported if place.error.right)

    @property
    def tracked(self) -> bool:
        return any(place.error.right for place in self.claims)

    @property
    def right(self) -> bool:
        return self.error is not None and self.error.right

    @property
    def confident(self) -> bool:
        """Whether there is an estimate, with a probability of 0.9 or more."""
        return bool(self.claims) and self.claims[0].probability >= CONFIDENT_PROBABILITY


def facts_of(step: int, stamp_ns: int, outcome: Outcome, truth: PoseTuple | None) -> StepFacts:
    return StepFacts(
        step=step,
        stamp_ns=stamp_ns,
        state=outcome.state,
        truth=truth,
        reported=tuple(
            ReportedPlace(place.probability, pose_error(place.pose, truth))
            for place in outcome.hypotheses
            if truth
        ),
        elsewhere=outcome.elsewhere_probability,
        off_map=outcome.off_map_probability,
    )


class RunMeasures(msgspec.Struct, frozen=True, kw_only=True):
    """The measures of one run. None: the event did not occur, or there are no data."""

    steps: int
    localized: bool
    """Whether the estimates of the last 10 scored steps, or of all if fewer, were right."""
    final_error_m: float | None
    final_error_rad: float | None
    """Errors of the estimate at the last scored step."""
    localized_at_step: int | None
    """The first step from which the estimate is right for good."""
    localized_at_s: float | None
    """Time from the first step to `localized_at_step`."""
    confidently_wrong_fraction: float | None
    """Of the scored steps: the estimate was wrong, with a probability of 0.9 or more."""
    truth_tracked_fraction: float | None
    """Fraction of the scored steps after the first search at which the truth was tracked."""
    truth_probability_mean: float | None
    """Mean over the scored steps after the first search of the probability of all right places."""
    rmse_m: float | None
    """Root mean square error of the position once right for good."""
    sure_and_right_at_step: int | None
    """The first step whose estimate is right and has a probability of 0.9 or more."""
    log_score_mean: float | None
    """Mean over all scored steps of the natural logarithm of the reported probability of all
    right places together, bounded below by 0.001. 0 is the best."""
    truth_probability_lowest_once_sure: float | None
    """Lowest reported probability of all right places, from `sure_and_right_at_step` on."""
    brier_mean: float | None
    """Brier score, mean over all scored steps: (1 - p)^2, with p the reported probability of all
    right places together, plus the squared probabilities of the wrong places. Probability given
    to no place, as to "elsewhere", counts 0. 0 is sure and right, 1 no place, 2 sure and wrong."""
    elsewhere_probability_mean: float | None
    off_map_probability_mean: float | None
    """Means over all steps, scored or not."""
    localized_fraction: float
    ambiguous_fraction: float
    lost_fraction: float
    searching_fraction: float
    """Of all steps, scored or not: those with this state."""
    wall_s: float
    """Duration of the run without loading the map [s]."""
    cpu_s: float
    """CPU time of the run, of all threads [s]."""


def measures_of(
    facts: Sequence[StepFacts], *, wall_s: float = 0.0, cpu_s: float = 0.0
) -> RunMeasures:
    scored = [each for each in facts if each.truth]
    first_search_over = dropwhile(lambda each: each.state == "searching", facts)
    held = [each for each in first_search_over if each.truth]
    final = scored[-1].error if scored else None
    good = right_for_good(scored)
    once_sure = list(dropwhile(lambda each: not (each.right and each.confident), scored))
    squared_m2 = mean(each.error.distance_m**2 for each in good if each.error)
    elsewhere = [each.elsewhere for each in facts]
    return RunMeasures(
        steps=len(facts),
        localized=bool(good),
        final_error_m=final.distance_m if final else None,
        final_error_rad=final.heading_rad if final else None,
        localized_at_step=good[0].step if good else None,
        localized_at_s=(good[0].stamp_ns - facts[0].stamp_ns) / 1e9 if good else None,
        confidently_wrong_fraction=mean(each.confident and not each.right for each in scored),
        truth_tracked_fraction=mean(each.tracked for each in held),
        truth_probability_mean=mean(
            each.truth_probability if each.claims else 0.0 for each in held
        ),
        rmse_m=None if squared_m2 is None else math.sqrt(squared_m2),
        sure_and_right_at_step=once_sure[0].step if once_sure else None,
        log_score_mean=mean(
            math.log(max(each.truth_probability, LEAST_PROBABILITY)) for each in scored
        ),
        truth_probability_lowest_once_sure=min(
            (each.truth_probability for each in once_sure), default=None
        ),
        brier_mean=mean(map(brier, scored)),
        elsewhere_probability_mean=mean(p for p in elsewhere if p is not None),
        off_map_probability_mean=mean(each.off_map for each in facts),
        **{
            f"{state}_fraction": mean(each.state == state for each in facts) or 0.0
            for state in ("localized", "ambiguous", "lost", "searching")
        },
        wall_s=wall_s,
        cpu_s=cpu_s,
    )


def mean(values: Iterable[float]) -> float | None:
    """Return the mean; None: there are no values."""
    values = list(values)
    return float(np.mean(values)) if values else None


def brier(facts: StepFacts) -> float:
    """Return the Brier score of a step, in which all right places count as one."""
    wrong = math.fsum(p**2 for p, error in facts.reported if not error.right)
    return (1.0 - facts.truth_probability) ** 2 + wrong


def right_for_good(scored: Sequence[StepFacts]) -> Sequence[StepFacts]:
    """Return the last steps, all right; empty if fewer than 10 steps, unless all are right."""
    count = sum(1 for _ in takewhile(lambda each: each.right, reversed(scored)))
    return scored[len(scored) - count :] if count >= min(LAST_STEPS, len(scored)) else ()
