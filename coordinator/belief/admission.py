"""Which places of a search enter beside the clusters, and how probable they are (section 4).

A search explains what the belief calls elsewhere. A place that it finds has what elsewhere had
when the search began, times the likelihood of all scans since, times its share; the clusters have
what they had, times what they have gathered since.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coordinator.belief.search_pool import Pool
from particle_filter.overlaps import is_near
from particle_filter.settings import BeliefSettings, FilterSettings, SearchSettings
from protocol.message import PoseTuple
from protocol.work import Place


def first_places(pool: Pool, rules: BeliefSettings) -> list[Place]:
    """The places of a first search that are tracked, as probable as their shares.

    Returns:
        Most probable first; what their shares lack of one is elsewhere.
    """
    first = enumerate(pool.share[: rules.max_clusters])
    return [pool.place(index, share) for index, share in first if share >= rules.least_probability]


MOST_LOG = 100.0
"""Of a weight beside the belief: all the rest is nothing beside it, and numbers stay finite."""


@dataclass(frozen=True)
class Admission:
    """What a search comes to beside the clusters."""

    entering: tuple[Place, ...]
    """Most probable first, each with its weight beside the belief as its share."""
    explained: float
    """Share of the search that is where clusters are, or enters."""
    asking: int
    """Places that are probable enough to enter, whether there is room or not."""


def admission(
    pool: Pool,
    held: Sequence[PoseTuple],
    room: Sequence[float],
    log_weight: float,
    settings: FilterSettings,
    *,
    is_over: bool,
    holds_own: bool = False,
    most: float = math.inf,
    trial: float = 0.0,
) -> Admission:
    """The places of a search that no cluster holds and that are probable enough.

    When the search is over, its places get a trial all the same: the belief may have lost the
    robot without a sign of it. But one so near to a cluster that a search tells them no further
    apart is more likely that cluster's own, and has to earn its place.

    Args:
        pool: what the search has found.
        held: where the clusters were at the step of the pool.
        room: how probable the clusters are whose places could be taken, least first; 0 is a free
            place.
        log_weight: log of the weight of all that the search has found, beside the belief.
        settings: how near is near.
        is_over: it has seen all that it will see.
        holds_own: clusters are this search's own places, so it tells none from those beside them;
            and they tell what it is worth.
        most: so much all who enter can hold together, however they weigh among themselves; with
            that they have to be more probable than those whose places they take.
        trial: least weight beside the belief of all together when the search is over.
    """
    rules, search = settings.belief, settings.search
    reach_m = search.source_radius_m if holds_own else rules.merge_distance_m
    reach_rad = search.source_heading_rad if holds_own else rules.merge_heading_rad
    is_held = is_near(pool.mean, held, reach_m, reach_rad)
    is_beside = is_near(pool.mean, held, search.source_radius_m, search.source_heading_rad)
    share = np.array(pool.share)
    explained = sum(share[is_held].tolist(), start=0.0)
    earned = math.exp(min(log_weight, MOST_LOG))
    on_trial = (
        max(earned, rules.newcomer_probability, trial) if is_over and not holds_own else earned
    )
    weight = share * np.where(is_beside, earned, on_trial)
    asking = np.flatnonzero(~is_held & (share > 0.0) & (weight >= rules.least_probability))
    asking = asking[np.argsort(-weight[asking], kind="stable")]
    total = math.fsum(weight[asking])
    got = min(1.0, most / total) if total > 0.0 else 1.0
    entering = [
        index
        for index, leaving in zip(asking.tolist(), room, strict=False)
        if weight[index] * got > leaving
    ]
    explained += math.fsum(pool.share[index] for index in entering)
    weighed = tuple(pool.place(index, float(weight[index])) for index in entering)
    return Admission(weighed, min(explained, 1.0), len(asking))


def log_weight_of_held(
    pool: Pool, held: Sequence[tuple[PoseTuple, float]], rules: SearchSettings
) -> float | None:
    """Log of the weight of a whole search by what it shares with the clusters; None: nothing.

    For a search whose own places are clusters: they tell what its shares are worth.

    Args:
        pool: what the search has found.
        held: where its own clusters were at the step of the pool, and how probable they are.
        rules: how near is near.
    """
    reach = (rules.source_radius_m, rules.source_heading_rad)
    is_found = is_near([mean for mean, _ in held], pool.mean, *reach)
    near = [one for one, found in zip(held, is_found, strict=True) if found]
    is_of_near = is_near(pool.mean, [mean for mean, _ in near], *reach)
    share = math.fsum(np.array(pool.share)[is_of_near])
    probability = math.fsum(probability for _, probability in near)
    return math.log(probability / share) if probability > 0.0 and share > 0.0 else None
