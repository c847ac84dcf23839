"""The measures of one run: every term of the experiments' tables is defined here.

- *Update*: one step, that is one gated scan; updates are counted from 1.
- *Estimate*: the most probable place. During the first search there is none.
- *Right*: within 1 m and 20 degrees of the ground truth.
- *After the bootstrap*: from the update at which the first search has ended.
- *Copies* of a k-fold symmetric map: the true pose and its images under the map's rotations.
- *Tracked*: a copy with a place within 1 m and 20 degrees of it.
- *Feature seen*: the first update in a nearly symmetric map at which 3 or more beams would differ
  by more than 0.3 m at every other copy (see `observability`).
- *Right for good*: from the first update after which every estimate of the run is right.
- *Judged*: an update with a known true pose. Others count only in the number of updates, in their
  states and in the probability of no place.
- *Reported*: the places of an update with their probabilities, including the first search's.

`clustermcl evaluate` computes some of these measures under other names.
"""

import math
import statistics
from collections.abc import Sequence
from itertools import dropwhile, pairwise, takewhile

import msgspec
import numpy as np
from numpy.typing import NDArray

from evaluation.experiments.step_facts import StepFacts
from particle_filter.belief import normalised_entropy
from protocol.answers import State

Counts = NDArray[np.float64]
IN_A_ROW = 5
"""This number of right estimates in a row is not accidental."""
LAST_UPDATES = 10
"""A run with this number of right estimates at its end is localized."""
BINS = 10
LEAST_PROBABILITY = 0.001
"""Lower bound of probabilities before the logarithm: an update costs at most 6.9 nat."""


class RunMeasures(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The measures of one run. None: the event did not occur, or there are no data."""

    updates: int
    """Steps of the run."""
    localized: bool
    """The estimates of the last 10 updates (of all, if there were fewer) were right."""
    final_error_m: float | None
    """Position error of the last estimate."""
    final_error_rad: float | None
    """Heading error of the last estimate."""
    settled_at_update: int | None
    """If localized: right for good from this update on."""
    settled_after_s: float | None
    """Time from the first update to that one."""
    rmse_m: float | None
    """Root mean square error of the position once right for good."""
    confidently_wrong_share: float | None
    """Share of the updates whose estimate was wrong and had a probability of 0.9 or more."""
    tracked_share: float | None
    """Share of the updates after the bootstrap on which the truth was tracked."""
    kept_share: float | None
    """The same from the first 5 right estimates in a row on: whether tracking is kept."""
    truth_probability: float | None
    """Mean over the same updates of the probability of all right places together."""

    sure_and_right_at_update: int | None
    """The first update whose estimate is right and has a probability of 0.9 or more."""
    truth_lowest_once_sure: float | None
    """The lowest reported probability of all right places together, from that update on."""
    log_score: float | None
    """Mean over all judged updates of the natural logarithm of the reported probability of all
    right places together, bounded below by 0.001. 0 is the best."""
    brier: float | None
    """Brier score, mean over the same updates: (1 - p)^2, with p the reported probability of all
    right places together, plus the squared probabilities of the wrong places. Probability given
    to no place, as to "elsewhere", counts 0. 0 is sure and right, 1 no place, 2 sure and wrong."""
    elsewhere_probability: float | None
    """Mean over all updates of the probability that the robot is at none of the places."""
    off_map_probability: float
    """Mean over all updates of the probability that the robot is not on the map."""

    right_share: float
    """Share of the updates whose estimate was right."""
    right_at_50: bool | None
    """Whether the estimate of update 50 was right."""
    right_at_100: bool | None
    """Whether the estimate of update 100 was right."""
    right_within: int | None
    """The first update of the first 5 right estimates in a row."""
    bootstrap_update: int | None
    """The update at which the first search ended."""
    copies_found: int | None
    """Number of copies tracked at that update."""

    all_tracked_share: float | None
    """Share of the updates after the bootstrap on which all copies were tracked."""
    entropy_mean: float | None
    """Mean over the updates after the bootstrap of the normalised entropy of the copies'
    probabilities: 1 is no preference, 0 is certainty or no tracked copy."""
    entropy_min: float | None
    """The lowest normalised entropy."""
    leader_changes: int
    """Number of updates at which the most probable copy changed."""

    seen_at_update: int | None
    """The update at which the robot sees the feature."""
    all_tracked_until_seen_share: float | None
    """Share of the updates after the bootstrap and before that on which all copies were tracked."""
    settled_after_seen: int | None
    """Updates from seeing the feature to being right for good; 0 if it was right before."""

    kidnapped_at_update: int | None
    """The update after which the robot was kidnapped."""
    right_before_kidnap: bool | None
    """Whether the estimate was right 40 times in a row before, as intended."""
    alarm_after_kidnap: int | None
    """Updates from then to the first one with the state `lost`, `ambiguous` or `searching`."""
    right_after_kidnap: int | None
    """Updates from then to the first of 5 in a row with right estimates."""

    localized_share: float
    """Share of all updates with the state `localized`, judged or not."""
    ambiguous_share: float
    """The same of `ambiguous`."""
    lost_share: float
    """The same of `lost`."""
    searching_share: float
    """The same of `searching`."""
    localized_wrong_share: float
    """Share of the updates with the state `localized` and a wrong estimate."""
    short_beam_share: float | None
    """Share of the beams that ended 0.3 m or more before the map's obstacle (occlusion)."""
    wall_s: float
    """Duration of the run without loading maps."""
    cpu_s: float
    """CPU time of the run, all threads."""


def measures_of(
    facts: Sequence[StepFacts],
    *,
    seen_at_update: int | None = None,
    kidnapped_at_update: int | None = None,
    right_before_kidnap: bool | None = None,
    short_beam_share: float | None = None,
    wall_s: float = 0.0,
    cpu_s: float = 0.0,
) -> RunMeasures:
    """Compute the measures of a run.

    Args:
        facts: its updates in order.
        seen_at_update: when the feature was seen.
        kidnapped_at_update: when the robot was kidnapped.
        right_before_kidnap: whether the estimate was right before.
        short_beam_share: share of occluded beams.
        wall_s: duration of the run [s].
        cpu_s: CPU time of the run [s].
    """
    held = [step for step in after_bootstrap(facts) if step.judged]
    judged = [step for step in facts if step.judged]
    final = judged[-1].error if judged else None
    good = right_for_good(judged)
    settled = good[0].update if good else None
    once_sure = from_sure_on(judged)
    elsewhere = [step.elsewhere for step in facts if step.elsewhere is not None]
    entropies = [entropy_of_copies(step) for step in held]
    seen = seen_at_update
    after_kidnap = [f for f in judged if kidnapped_at_update and f.update > kidnapped_at_update]
    return RunMeasures(
        updates=len(facts),
        localized=bool(good),
        final_error_m=final.distance_m if final else None,
        final_error_rad=final.heading_rad if final else None,
        settled_at_update=settled,
        settled_after_s=(good[0].stamp_ns - facts[0].stamp_ns) / 1e9 if good else None,
        rmse_m=root_mean_square([step.error.distance_m for step in good if step.error]),
        confidently_wrong_share=share([step.confidently_wrong for step in judged]),
        tracked_share=share([step.tracked for step in held]),
        kept_share=kept_share(judged),
        truth_probability=share([step.copies[0] or 0.0 for step in held]),
        sure_and_right_at_update=once_sure[0].update if once_sure else None,
        truth_lowest_once_sure=min((step.truth_told for step in once_sure), default=None),
        log_score=share([log_score(step) for step in judged]),
        brier=share([brier(step) for step in judged]),
        elsewhere_probability=share(elsewhere),
        off_map_probability=share([step.off_map for step in facts]) or 0.0,
        right_share=share([step.right for step in judged]) or 0.0,
        right_at_50=right_at(judged, 50),
        right_at_100=right_at(judged, 100),
        right_within=first_right(judged),
        bootstrap_update=held[0].update if held else None,
        copies_found=sum(p is not None for p in held[0].copies) if held else None,
        all_tracked_share=share([step.all_tracked for step in held]),
        entropy_mean=statistics.fmean(entropies) if entropies else None,
        entropy_min=min(entropies, default=None),
        leader_changes=leader_changes(judged),
        seen_at_update=seen,
        all_tracked_until_seen_share=(
            share([step.all_tracked for step in held if step.update < seen]) if seen else None
        ),
        settled_after_seen=max(settled - seen, 0) if seen and settled else None,
        kidnapped_at_update=kidnapped_at_update,
        right_before_kidnap=right_before_kidnap,
        alarm_after_kidnap=since(first_alarm(after_kidnap), kidnapped_at_update),
        right_after_kidnap=since(first_right(after_kidnap), kidnapped_at_update),
        localized_share=state_share(facts, "localized"),
        ambiguous_share=state_share(facts, "ambiguous"),
        lost_share=state_share(facts, "lost"),
        searching_share=state_share(facts, "searching"),
        localized_wrong_share=(
            share([step.state == "localized" and not step.right for step in judged]) or 0.0
        ),
        short_beam_share=short_beam_share,
        wall_s=wall_s,
        cpu_s=cpu_s,
    )


def calibration_of(facts: Sequence[StepFacts]) -> Counts:
    """Return counts per tenth of probability, for reliability diagrams.

    Returns:
        (3, 10): number of estimates, number of right ones, and sum of their probabilities.
    """
    counts = np.zeros((3, BINS))
    for step in facts:
        if step.judged and step.claims:
            part = min(int(step.probability * BINS), BINS - 1)
            counts[:, part] += 1.0, step.right, step.probability
    return counts


def after_bootstrap(facts: Sequence[StepFacts]) -> Sequence[StepFacts]:
    """Return the updates from the end of the first search."""
    first = next((i for i, step in enumerate(facts) if step.state != "searching"), len(facts))
    return facts[first:]


def right_for_good(judged: Sequence[StepFacts]) -> Sequence[StepFacts]:
    """Return the final run of right estimates; empty if under 10 of them and not all updates."""
    count = sum(1 for _ in takewhile(lambda step: step.right, reversed(judged)))
    return judged[len(judged) - count :] if count >= min(LAST_UPDATES, len(judged)) else ()


def from_sure_on(judged: Sequence[StepFacts]) -> Sequence[StepFacts]:
    """From the first update on whose estimate is sure and right; none without one."""
    return tuple(dropwhile(lambda step: not step.sure_and_right, judged))


def log_score(step: StepFacts) -> float:
    """Natural logarithm of the right places' probability, bounded; see `RunMeasures`."""
    return math.log(max(step.truth_told, LEAST_PROBABILITY))


def brier(step: StepFacts) -> float:
    """Brier score with all right places as one; see `RunMeasures`."""
    wrong = math.fsum(probability**2 for probability, right in step.told if not right)
    return (1.0 - step.truth_told) ** 2 + wrong


def root_mean_square(values: Sequence[float]) -> float | None:
    """Of none: None."""
    return math.sqrt(sum(value**2 for value in values) / len(values)) if values else None


def share(flags: Sequence[bool] | Sequence[float]) -> float | None:
    """Share of those that are set, or the mean; None of none."""
    return sum(flags) / len(flags) if flags else None


def state_share(facts: Sequence[StepFacts], state: State) -> float:
    """Share of the updates with a state; 0 of none."""
    return share([step.state == state for step in facts]) or 0.0


def right_at(facts: Sequence[StepFacts], update: int) -> bool | None:
    """Whether the estimate of one update was right; None if it was not judged."""
    return next((step.right for step in facts if step.update == update), None)


def first_right(facts: Sequence[StepFacts], in_a_row: int = IN_A_ROW) -> int | None:
    """Return the first update of the first `IN_A_ROW` right estimates in a row."""
    streak = 0
    for index, step in enumerate(facts):
        streak = streak + 1 if step.right else 0
        if streak == in_a_row:
            return facts[index - in_a_row + 1].update
    return None


def kept_share(facts: Sequence[StepFacts]) -> float | None:
    """Share of the updates since the first 5 right ones in a row on which the truth is tracked."""
    begin = first_right(facts)
    return share([step.tracked for step in facts if step.update >= begin]) if begin else None


def first_alarm(facts: Sequence[StepFacts]) -> int | None:
    """The first update with a state that says not to trust the estimate."""
    return next((step.update for step in facts if step.state != "localized"), None)


def since(update: int | None, begin: int | None) -> int | None:
    """Updates from one to another; None if either is missing."""
    return None if update is None or begin is None else update - begin


def entropy_of_copies(step: StepFacts) -> float:
    """Entropy of the copies' probabilities over that of equal ones; 0 if no copy is tracked."""
    probabilities = np.array([p or 0.0 for p in step.copies])
    return normalised_entropy(probabilities) if probabilities.sum() > 0.0 else 0.0


def leader_changes(facts: Sequence[StepFacts]) -> int:
    """How often the most probable copy changed; updates with no copy tracked are passed over."""
    leaders = [step.leader for step in facts if step.leader is not None]
    return sum(before != after for before, after in pairwise(leaders))
