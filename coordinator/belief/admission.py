"""Which places of a restart enter beside the clusters, and with what probability (section 4)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from msgspec.structs import replace

from coordinator.belief.fit_monitor import FitMonitor
from coordinator.belief.search_pool import Pool
from particle_filter.overlaps import is_near
from particle_filter.settings import BeliefSettings, FilterSettings
from protocol.message import PoseTuple
from protocol.work import Place

ALTERNATIVE = 0.1
"""Of the best cluster's probability: who has so much is where the robot may well be."""


@dataclass(frozen=True)
class Terms:
    """On what terms newcomers enter."""

    most: int
    """So many at most."""
    least_share: float
    """Of its search, that a place needs."""
    probability: float
    """Given to all newcomers together."""
    replaces_alternatives: bool
    """Whether they may take the places of clusters that the robot may well be at."""


def terms(pool: Pool, fit: FitMonitor, rules: BeliefSettings) -> Terms:
    """How much of the belief what a search has found may take.

    A lost robot of which the search has found a place that fits as scans usually do has been
    moved: most clusters make room. Where nothing fits as usual, people may stand around. While
    scans fit, what was tracked for long tells more than the few scans of a search.
    """
    if not fit.lost:
        return Terms(rules.newcomers, rules.newcomer_min_share, rules.newcomer_probability, False)
    if fit.is_usual(pool.log_likelihood_per_beam):
        return Terms(rules.found_newcomers, rules.found_min_share, rules.found_probability, True)
    return Terms(rules.newcomers, rules.newcomer_min_share, rules.lost_newcomer_probability, True)


def newcomers(
    pool: Pool,
    held: Sequence[PoseTuple],
    yielding: Sequence[float],
    best: float,
    given: Terms,
    settings: FilterSettings,
) -> list[Place]:
    """The best places of a restart that no cluster holds.

    A search tells places apart no better than by its source radius. A place so near to a cluster
    is more likely that cluster's own than a new one, and its particles soon run together with
    it: nobody more probable than itself leaves for it.

    Args:
        pool: what the search has found.
        held: where the clusters were at the step of the pool.
        yielding: how probable the clusters are whose places could be taken, least first; 0 is a
            free place.
        best: how probable the most probable cluster is.
        given: on what terms they enter.
        settings: how near is near.

    Returns:
        Each with the probability that it enters with as its share, at most as many as `yielding`.
    """
    rules, search = settings.belief, settings.search
    fresh = [
        place
        for place in pool.places
        if place.share >= given.least_share
        and not is_near(place.mean, held, rules.merge_distance_m, rules.merge_heading_rad)
    ]
    beside = [
        is_near(place.mean, held, search.source_radius_m, search.source_heading_rad)
        for place in fresh
    ]
    apart_first = sorted(zip(beside, fresh, strict=True), key=lambda pair: pair[0])
    if not given.replaces_alternatives:
        yielding = [leaving for leaving in yielding if leaving < ALTERNATIVE * best]
    most = min(given.most, len(yielding))
    total = math.fsum(place.share for _, place in apart_first[:most])
    entering = [
        place
        for (is_beside, place), leaving in zip(apart_first[:most], yielding, strict=False)
        if not is_beside or given.probability * place.share / total > leaving
    ]
    total = math.fsum(place.share for place in entering)
    return [replace(place, share=given.probability * place.share / total) for place in entering]
