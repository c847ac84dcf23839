"""Select the places of a search that become clusters, and give their probabilities (section 4).

A search explains what the belief calls elsewhere, so its places take that probability by their
shares. Its scans count no more: they have moved elsewhere already, and an error of the map would
repeat in each of them.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from clustermcl.belief.cluster_set import Candidate, ClusterSet
from clustermcl.belief.given_places import moved_pose
from clustermcl.belief.overlaps import is_near
from clustermcl.belief.search_pool import Pool
from clustermcl.filter.settings import BeliefSettings, FilterSettings, SearchSettings
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.work import Place


def first_candidates(pool: Pool, prior: Place | None, rules: BeliefSettings) -> list[Candidate]:
    """Return the places of a first search, most probable first, and the robot's last pose.

    The share of a place is its probability, of which `prior` leaves a part. The rest, up to one, is
    the probability of elsewhere. If the last pose is one of the places, they merge.

    Args:
        pool: the places of the search.
        prior: the last pose as it was after an earlier step; it is tracked from there.
        rules: contain the largest number of clusters, and their least probability.

    Returns:
        Empty while no place is probable enough.
    """
    first = enumerate(pool.share[: rules.max_clusters])
    found = [pool.place(index, share) for index, share in first if share >= rules.least_probability]
    if prior is None or not found:
        return [(place, "first search") for place in found]
    now = moved_pose(prior.pose, prior.sample.odom_from_robot, pool.views.odom_from_robot)
    kept, left = found[: rules.max_clusters - 1], 1.0 - prior.share
    return [
        *((replace(place, share=left * place.share), "first search") for place in kept),
        (replace(prior, pose=now), "prior pose"),
    ]


MOST_LOG = 100.0
"""Bound of a log weight relative to the belief: far more is the same, and numbers stay finite."""


@dataclass(frozen=True)
class Admission:
    """The result of comparing a search with the clusters."""

    entering: tuple[Place, ...]
    """Most probable first; the share of each is its weight relative to the belief."""
    explained: float
    """Share of the search's probability in these places."""
    is_shared: bool
    """Whether they share the probability of clusters that are places of the same search."""


def admission(
    pool: Pool,
    clusters: ClusterSet,
    then: Mapping[str, PoseTuple],
    first_step: int,
    settings: FilterSettings,
    *,
    is_over: bool,
) -> Admission:
    """Select the places of a search that no cluster holds and that are probable enough.

    When the search is over, its places get a trial weight: the belief may have lost the robot
    without noticing.

    Args:
        pool: the places of the search.
        clusters: those that began at `first_step` or later are places of this search; they give
            it its weight.
        then: where they were at the step of the pool, by job.
        first_step: first step of the search.
        settings: distances at which places count as one, and their least weights.
        is_over: the search takes no further scans.
    """
    rules, search = settings.belief, settings.search
    held = [then[job_id] for job_id in clusters.job_ids]
    own = [(then[c.job_id], c.probability) for c in clusters.all() if c.born_step >= first_step]
    log_weight, most = clusters.log_elsewhere, math.inf
    log_held = log_weight_of_held(pool, own, search)
    if log_held is not None:
        log_weight = log_held
        most = math.fsum(probability for _, probability in own)
    is_held = is_near(pool.mean, held, *search.reach)
    share = np.array(pool.share)
    weight_of_all = math.exp(min(log_weight, MOST_LOG))
    if is_over and not own:
        weight_of_all = max(weight_of_all, rules.candidate_probability)
    weight = share * weight_of_all
    enough = (share > 0.0) & (weight >= rules.least_probability)
    eligible = np.flatnonzero(~is_held & enough)
    eligible = eligible[np.argsort(-weight[eligible], kind="stable")]
    total = math.fsum(weight[eligible])
    got = min(1.0, most / total) if total > 0.0 else 1.0
    entering = [
        index
        for index, leaving in zip(eligible.tolist(), clusters.room(), strict=False)
        if weight[index] * got > leaving
    ]
    explained = math.fsum(share[entering])
    weighed = tuple(pool.place(index, float(weight[index])) for index in entering)
    return Admission(weighed, min(explained, 1.0), log_held is not None)


def log_weight_of_held(
    pool: Pool, held: Sequence[tuple[PoseTuple, float]], rules: SearchSettings
) -> float | None:
    """Return the log weight of a search, computed from its places that are clusters already.

    The weight is the ratio of their probability as clusters to their share in the search.

    Args:
        pool: the places of the search.
        held: pose, at the step of the pool, and probability of each cluster from this search.
        rules: distances within which a place and a cluster are the same.

    Returns:
        The log weight; None: no place of the pool is a cluster.
    """
    is_found = is_near([mean for mean, _ in held], pool.mean, *rules.reach)
    near = [one for one, found in zip(held, is_found, strict=True) if found]
    is_of_near = is_near(pool.mean, [mean for mean, _ in near], *rules.reach)
    share = math.fsum(np.array(pool.share)[is_of_near])
    probability = math.fsum(probability for _, probability in near)
    return math.log(probability / share) if probability > 0.0 and share > 0.0 else None
