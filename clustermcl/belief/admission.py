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

from clustermcl.belief.cluster_set import Candidate, Cluster, ClusterSet
from clustermcl.belief.given_places import moved_pose
from clustermcl.belief.overlaps import is_near
from clustermcl.belief.search_pool import Pool
from clustermcl.filter.settings import SearchSettings
from clustermcl.protocol.job_events import BeganCause
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.work import Place

MOST_LOG = 100.0
"""Bound of a log weight relative to the belief: far more is the same, and numbers stay finite."""


@dataclass(frozen=True)
class Admission:
    """The places of a search that become clusters, and which hypotheses make way."""

    entering: tuple[Candidate, ...]
    """Most probable first; the share of each is its weight relative to the belief."""
    explained: float
    """Share of the search's probability in these places, which elsewhere loses."""
    earlier: tuple[Cluster, ...] = ()
    """Earlier places of the same search, which make way in place of elsewhere."""
    kept: float = 1.0
    """Share of their probability that these keep."""

    def make_way(self, clusters: ClusterSet) -> None:
        """Take the probability of what enters."""
        if not self.earlier:
            clusters.take_from_elsewhere(self.explained)
        for cluster in self.earlier:
            log_probability = cluster.log_probability + math.log(self.kept)
            clusters.change(cluster, log_probability=log_probability)


def first_admission(pool: Pool, prior: Place | None, clusters: ClusterSet) -> Admission:
    """Select the places of a first search, and the robot's last pose.

    The share of a place is its probability, of which `prior` leaves a part. The rest, up to one, is
    the probability of elsewhere. If the last pose is one of the places, they merge.

    Args:
        pool: the places of the search.
        prior: the last pose as it was after an earlier step; it is tracked from there.
        clusters: none yet, with the largest number of clusters, and their least probability.

    Returns:
        Nothing enters while no place is probable enough.
    """
    rules, before = clusters.rules, clusters.elsewhere
    first = enumerate(pool.share[: rules.max_clusters])
    found = [pool.place(index, share) for index, share in first if share >= rules.least_probability]
    entering: list[Candidate] = [(place, "first search") for place in found]
    if prior is not None and found:
        now = moved_pose(prior.pose, prior.sample.odom_from_robot, pool.views.odom_from_robot)
        left = 1.0 - prior.share
        entering = [
            *((replace(p, share=left * p.share), c) for p, c in entering[: rules.max_clusters - 1]),
            (replace(prior, pose=now), "prior pose"),
        ]
    explained = min(math.fsum(place.share for place, _ in entering), 1.0)
    weighed = ((replace(place, share=before * place.share), cause) for place, cause in entering)
    return Admission(tuple(weighed), explained)


def admission(
    pool: Pool,
    clusters: ClusterSet,
    then: Mapping[str, PoseTuple],
    first_step: int,
    cause: BeganCause,
    *,
    is_over: bool = False,
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
        cause: why they become clusters.
        is_over: the search takes no further scans.
    """
    rules, search = clusters.rules, clusters.settings.search
    held = [then[job_id] for job_id in clusters.job_ids]
    own = tuple(cluster for cluster in clusters.all() if cluster.born_step >= first_step)
    log_weight, most = clusters.log_elsewhere, math.inf
    log_held = log_weight_of_held(pool, [(then[c.job_id], c.probability) for c in own], search)
    if log_held is not None:
        log_weight = log_held
        most = math.fsum(cluster.probability for cluster in own)
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
    explained = min(math.fsum(share[entering]), 1.0)
    kept = 1.0 if log_held is None else most / (most + math.fsum(weight[entering]))
    places = ((pool.place(index, kept * float(weight[index])), cause) for index in entering)
    return Admission(tuple(places), explained, () if log_held is None else own, kept)


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
