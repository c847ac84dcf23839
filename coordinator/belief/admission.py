"""Which places of a search enter beside the clusters, and how probable they are (section 4).

A search explains what the belief calls elsewhere. A place that it finds has what elsewhere had
when the search began, times the likelihood of all scans since, times its share; the clusters have
what they had, times what they have gathered since.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from coordinator.belief.search_pool import Pool
from particle_filter.evidence_model import counted, misfit, share_that_counts
from particle_filter.overlaps import is_near
from particle_filter.settings import BeliefSettings, FilterSettings
from protocol.message import PoseTuple
from protocol.work import Place


def first_places(pool: Pool, settings: FilterSettings) -> list[Place]:
    """The places of a first search that are tracked: as probable as their shares, as they count.

    Args:
        pool: what the search has found.
        settings: how evidence counts, and how many clusters there may be.

    Returns:
        Most probable first; their shares are probabilities, and what is left of one is elsewhere.
    """
    if not pool.places:
        return []
    rules = settings.belief
    shares = np.array([max(place.share, np.finfo(float).tiny) for place in pool.places])
    bad = misfit(pool.log_likelihood_per_beam, settings.sensor)
    worth = np.exp(counted(np.log(shares), share_that_counts(1.0, bad, rules)))
    worth *= min(math.fsum(shares), 1.0) / worth.sum()
    return [
        replace(place, share=float(probability))
        for place, probability in zip(pool.places, worth, strict=True)
        if probability >= rules.least_probability
    ][: rules.max_clusters]


MOST_LOG = 100.0
"""Of a weight beside the belief: all the rest is nothing beside it, and numbers stay finite."""


@dataclass(frozen=True)
class Admission:
    """What a search comes to beside the clusters."""

    entering: tuple[Place, ...]
    """Most probable first, each with its weight beside the belief as its share."""
    explained: float
    """Share of the search that is where clusters are, or enters."""


def admission(
    pool: Pool,
    held: Sequence[PoseTuple],
    room: Sequence[float],
    log_weight: float,
    settings: FilterSettings,
) -> Admission:
    """The places of a search that no cluster holds and that are probable enough.

    A place with much of its search gets a trial all the same: the search may know better. But one
    so near to a cluster that a search tells them no further apart is more likely that cluster's
    own, and has to earn its place.

    Args:
        pool: what the search has found.
        held: where the clusters were at the step of the pool.
        room: how probable the clusters are whose places could be taken, least first; 0 is a free
            place.
        log_weight: log of the weight of all that the search has found, beside the belief.
        settings: how near is near.
    """
    rules, search = settings.belief, settings.search
    fresh = list[tuple[Place, Place]]()
    explained = 0.0
    for place in pool.places:
        if is_near(place.mean, held, rules.merge_distance_m, rules.merge_heading_rad):
            explained += place.share
        elif place.share > 0.0:
            weight = math.exp(min(log_weight + math.log(place.share), MOST_LOG))
            beside = is_near(place.mean, held, search.source_radius_m, search.source_heading_rad)
            if place.share >= rules.newcomer_min_share and not beside:
                weight = max(weight, rules.newcomer_probability)
            if weight >= rules.least_probability:
                fresh.append((place, replace(place, share=weight)))
    fresh.sort(key=lambda pair: -pair[1].share)
    entering = [pair for pair, leaving in zip(fresh, room, strict=False) if pair[1].share > leaving]
    explained += math.fsum(place.share for place, _ in entering)
    return Admission(tuple(weighed for _, weighed in entering), min(explained, 1.0))


def log_weight_of_held(
    pool: Pool, held: Sequence[tuple[PoseTuple, float]], rules: BeliefSettings
) -> float | None:
    """Log of the weight of a whole search by what it shares with the clusters; None: nothing.

    For the first search, whose own places the clusters are: they tell what its shares are worth.

    Args:
        pool: what the search has found.
        held: where the clusters were at the step of the pool, and how probable they are.
        rules: how near is near.
    """
    near = [
        (mean, probability)
        for mean, probability in held
        if is_near(
            mean, [p.mean for p in pool.places], rules.merge_distance_m, rules.merge_heading_rad
        )
    ]
    share = math.fsum(
        place.share
        for place in pool.places
        if is_near(
            place.mean, [mean for mean, _ in near], rules.merge_distance_m, rules.merge_heading_rad
        )
    )
    probability = math.fsum(probability for _, probability in near)
    return math.log(probability / share) if probability > 0.0 and share > 0.0 else None
