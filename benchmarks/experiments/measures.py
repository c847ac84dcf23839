"""The measures of one run in the experiments' tables, in terms of `clustermcl.evaluation.measures`.

- *Update*: one step, that is one gated scan; updates are counted from 1.
- *After the bootstrap*: from the update at which the first search has ended.
- *Copies* of a k-fold symmetric map: the true pose and its images under the map's rotations.
- *Tracked*: a copy with a place within 1 m and 20 degrees of it.
- *Feature seen*: the first update in a nearly symmetric map at which 3 or more beams would differ
  by more than 0.3 m at every other copy (see `observability`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.stats import entropy

from clustermcl.belief.outcome import Outcome
from clustermcl.evaluation import measures as common
from clustermcl.evaluation.measures import StepFacts, mean, pose_error
from clustermcl.protocol.message import PoseTuple

Counts = NDArray[np.float64]
IN_A_ROW = 5
"""This number of right estimates in a row is not accidental."""
BINS = 10


@dataclass(frozen=True, slots=True)
class Update:
    """The facts of one update."""

    facts: StepFacts
    copies: tuple[float | None, ...]
    """For the true pose and each symmetric copy: total probability of the places that match it, or
    None if there is none. Empty: the true pose is unknown."""

    @property
    def number(self) -> int:
        """Number of the update; the first is 1."""
        return self.facts.step + 1

    @property
    def all_tracked(self) -> bool:
        """Whether the true pose and every symmetric copy have a place."""
        return None not in self.copies

    @property
    def leader(self) -> int | None:
        """Index of the most probable copy; None if no copy has a place."""
        held = [(p, -index) for index, p in enumerate(self.copies) if p is not None]
        return -max(held)[1] if held else None


def update_of(number: int, stamp_ns: int, outcome: Outcome, copies: Sequence[PoseTuple]) -> Update:
    """Return the facts of an update.

    Args:
        number: of the update; the first is 1.
        stamp_ns: time of its scan.
        outcome: the belief after it.
        copies: the true pose, then its symmetric copies; empty if unknown.
    """
    facts = common.facts_of(number - 1, stamp_ns, outcome, copies[0] if copies else None)
    places = outcome.hypotheses if facts.claims else ()
    near = [
        [place.probability for place in places if pose_error(place.pose, copy).right]
        for copy in copies
    ]
    return Update(facts, tuple(math.fsum(each) if each else None for each in near))


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
    """Mean over all scored updates of the natural logarithm of the reported probability of all
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
    """Share of all updates with the state `localized`, scored or not."""
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
    updates: Sequence[Update],
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
        updates: the run's updates in order.
        seen_at_update: when the feature was seen.
        kidnapped_at_update: when the robot was kidnapped.
        right_before_kidnap: whether the estimate was right before.
        short_beam_share: share of occluded beams.
        wall_s: duration of the run [s].
        cpu_s: CPU time of the run [s].
    """
    made = common.measures_of([each.facts for each in updates], wall_s=wall_s, cpu_s=cpu_s)
    scored = [each for each in updates if each.copies]
    first = next((each.number for each in updates if each.facts.state != "searching"), math.inf)
    held = [each for each in scored if each.number >= first]
    sure, settled = (
        None if step is None else step + 1
        for step in (made.sure_and_right_at_step, made.localized_at_step)
    )
    entropies = [entropy_of_copies(each) for each in held]
    seen = seen_at_update
    before_seen = [each for each in held if seen and each.number < seen]
    after_kidnap = [e for e in scored if kidnapped_at_update and e.number > kidnapped_at_update]
    kept_from = first_right(scored)
    return RunMeasures(
        updates=made.steps,
        localized=made.localized,
        final_error_m=made.final_error_m,
        final_error_rad=made.final_error_rad,
        settled_at_update=settled,
        settled_after_s=made.localized_at_s,
        rmse_m=made.rmse_m,
        confidently_wrong_share=made.confidently_wrong_fraction,
        tracked_share=made.truth_tracked_fraction,
        kept_share=mean(
            each.facts.tracked for each in scored if kept_from and each.number >= kept_from
        ),
        truth_probability=made.truth_probability_mean,
        sure_and_right_at_update=sure,
        truth_lowest_once_sure=made.truth_probability_lowest_once_sure,
        log_score=made.log_score_mean,
        brier=made.brier_mean,
        elsewhere_probability=made.elsewhere_probability_mean,
        off_map_probability=made.off_map_probability_mean or 0.0,
        right_share=mean(each.facts.right for each in scored) or 0.0,
        right_at_50=right_at(scored, 50),
        right_at_100=right_at(scored, 100),
        right_within=first_right(scored),
        bootstrap_update=held[0].number if held else None,
        copies_found=sum(p is not None for p in held[0].copies) if held else None,
        all_tracked_share=mean(each.all_tracked for each in held),
        entropy_mean=mean(entropies),
        entropy_min=min(entropies, default=None),
        leader_changes=leader_changes(scored),
        seen_at_update=seen,
        all_tracked_until_seen_share=mean(each.all_tracked for each in before_seen),
        settled_after_seen=max(settled - seen, 0) if seen and settled else None,
        kidnapped_at_update=kidnapped_at_update,
        right_before_kidnap=right_before_kidnap,
        alarm_after_kidnap=since(first_alarm(after_kidnap), kidnapped_at_update),
        right_after_kidnap=since(first_right(after_kidnap), kidnapped_at_update),
        localized_share=made.localized_fraction,
        ambiguous_share=made.ambiguous_fraction,
        lost_share=made.lost_fraction,
        searching_share=made.searching_fraction,
        localized_wrong_share=(
            mean(e.facts.state == "localized" and not e.facts.right for e in scored) or 0.0
        ),
        short_beam_share=short_beam_share,
        wall_s=made.wall_s,
        cpu_s=made.cpu_s,
    )


def calibration_of(updates: Sequence[Update]) -> Counts:
    """Return counts per tenth of probability, for reliability diagrams.

    Returns:
        (3, 10): number of estimates, number of right ones, and sum of their probabilities.
    """
    counts = np.zeros((3, BINS))
    for facts in (each.facts for each in updates):
        if facts.claims:
            probability = facts.claims[0].probability
            part = min(int(probability * BINS), BINS - 1)
            counts[:, part] += 1.0, facts.right, probability
    return counts


def right_at(updates: Sequence[Update], number: int) -> bool | None:
    """Return whether the estimate of one update was right; None if it was not scored."""
    return next((each.facts.right for each in updates if each.number == number), None)


def first_right(updates: Sequence[Update], in_a_row: int = IN_A_ROW) -> int | None:
    """Return the first update of the first `IN_A_ROW` right estimates in a row."""
    streak = 0
    for index, each in enumerate(updates):
        streak = streak + 1 if each.facts.right else 0
        if streak == in_a_row:
            return updates[index - in_a_row + 1].number
    return None


def first_alarm(updates: Sequence[Update]) -> int | None:
    """Return the first update with a state that says not to trust the estimate."""
    return next((each.number for each in updates if each.facts.state != "localized"), None)


def since(update: int | None, begin: int | None) -> int | None:
    """Return the updates from one to another; None if either is missing."""
    return None if update is None or begin is None else update - begin


def entropy_of_copies(update: Update) -> float:
    """Return the entropy of the copies over that of equal ones; 0 if no copy is tracked."""
    probabilities = np.array([p or 0.0 for p in update.copies])
    if len(probabilities) < 2 or not probabilities.any():
        return 0.0
    return float(entropy(probabilities)) / math.log(len(probabilities))


def leader_changes(updates: Sequence[Update]) -> int:
    """Return how often the most probable copy changed, without updates with no copy tracked."""
    leaders = [each.leader for each in updates if each.leader is not None]
    return sum(before != after for before, after in pairwise(leaders))
