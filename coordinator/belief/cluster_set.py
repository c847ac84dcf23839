"""The tracked places and their probabilities: at most K, always normalised."""

import math
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TypeAlias

import msgspec
import numpy as np
from msgspec.structs import replace

from particle_filter import belief
from particle_filter.arrays import Pose
from particle_filter.motion_covariance import composed_covariance, motion_covariance
from particle_filter.overlaps import merge_overlapping
from particle_filter.poses import compose
from particle_filter.settings import BeliefSettings, MotionSettings
from protocol.job_events import Began, BeganCause, Ended, EndedCause, JobEvent
from protocol.message import Covariance, PoseTuple
from protocol.pose_arrays import covariance_matrix, covariance_tuple, pose_tuple
from protocol.work import Place, TrackReport

LEAST_PROBABILITY = sys.float_info.min
"""Given to a newcomer whose share is so small that it underflows to zero."""


class Cluster(msgspec.Struct, frozen=True):
    """One tracked place."""

    cluster: int
    log_probability: float
    born_step: int
    mean: PoseTuple
    covariance: Covariance
    protected_until: int = -1
    """The step before which it may not be replaced."""
    effective_sample_size: float = 0.0

    @property
    def job_id(self) -> str:
        """The job that tracks it."""
        return f"c{self.cluster}"

    @property
    def probability(self) -> float:
        """That the robot is there."""
        return math.exp(self.log_probability)


Newcomer: TypeAlias = tuple[Place, BeganCause]
"""A place that asks to be tracked with its share as its probability, and where it comes from."""


class ClusterSet:
    """All clusters of one robot, in the order of their numbers."""

    def __init__(self, rules: BeliefSettings) -> None:
        self._rules = rules
        self._clusters: dict[int, Cluster] = {}
        self._next_cluster = 0

    def __len__(self) -> int:
        return len(self._clusters)

    @property
    def next_cluster(self) -> int:
        """The number that the next newcomer gets."""
        return self._next_cluster

    def all(self) -> tuple[Cluster, ...]:
        """All of them, in the order in which they are summed."""
        return tuple(self._clusters.values())

    def restore(self, clusters: Iterable[Cluster], next_cluster: int) -> None:
        """Be as another set was."""
        self._clusters = {cluster.cluster: cluster for cluster in clusters}
        self._next_cluster = next_cluster

    @property
    def job_ids(self) -> tuple[str, ...]:
        """The jobs that track the clusters."""
        return tuple(cluster.job_id for cluster in self._clusters.values())

    def by_probability(self) -> list[Cluster]:
        """Most probable first."""
        return sorted(self._clusters.values(), key=lambda c: (-c.log_probability, c.cluster))

    def weigh(self, reports: Mapping[str, TrackReport]) -> None:
        """One Bayes update (eq. 12-17), then the transition between clusters."""
        if not self._clusters:
            return
        evidence = np.full(len(self._clusters), np.nan)
        for index, cluster in enumerate(self._clusters.values()):
            report = reports.get(cluster.job_id)
            if report is not None:
                evidence[index] = report.log_weight_sum - math.log(report.particles)
                self._clusters[cluster.cluster] = replace(
                    cluster,
                    mean=report.mean,
                    covariance=report.covariance,
                    effective_sample_size=report.effective_sample_size,
                )
        posterior = belief.updated(
            self._log_probabilities(),
            belief.bounded(evidence, self._rules.evidence_bound),
            squared_prior=self._rules.squared_prior,
        )
        self._set(belief.mixed(posterior, self._rules.transition_probability))

    def carry(
        self, job_ids: Collection[str], before_from_after: Pose, motion: MotionSettings
    ) -> None:
        """Move clusters that were not heard of by odometry: nobody else says where they are now.

        Args:
            job_ids: theirs.
            before_from_after: (3,) how the robot moved since the step before.
            motion: how far odometry errs; they grow less certain by it.
        """
        noise = motion_covariance(before_from_after, motion)
        for cluster in self.all():
            if cluster.job_id in job_ids:
                mean, known = np.array(cluster.mean), covariance_matrix(cluster.covariance)
                covariance = composed_covariance(mean, known, before_from_after, noise)
                self._clusters[cluster.cluster] = replace(
                    cluster,
                    mean=pose_tuple(compose(mean, before_from_after)),
                    covariance=covariance_tuple(covariance),
                )

    def merge_overlaps(self) -> list[Ended]:
        """Join clusters at the same place: probabilities add, the most probable one stays."""
        ordered = self.by_probability()
        if len(ordered) < 2:
            return []
        rules, ended = self._rules, list[Ended]()
        means = np.array([cluster.mean for cluster in ordered])
        into = merge_overlapping(means, rules.merge_distance_m, rules.merge_heading_rad)
        for index in np.unique(into):
            first, *rest = [ordered[member] for member in np.flatnonzero(into == index)]
            total = np.logaddexp.reduce([c.log_probability for c in (first, *rest)])
            self._clusters[first.cluster] = replace(first, log_probability=float(total))
            ended += self._end(rest, "merged", first)
        return ended

    def yielding(self, step: int) -> list[float]:
        """How probable those are whose places newcomers would take now, in the order of leaving.

        Free places come first, as clusters of probability 0; those in their grace yield to nobody.
        """
        free = self._rules.clusters - len(self._clusters)
        return [0.0] * free + [c.probability for c in self._leaving(step)]

    def admit(
        self, newcomers: Sequence[Newcomer], step: int, *, protected_until: int = -1
    ) -> tuple[list[Cluster], list[JobEvent]]:
        """Let newcomers in; the least probable clusters leave, so that there are never above K.

        Each newcomer takes a place as `yielding` has them: the free ones first, then those of the
        clusters that leave, the least probable first.

        Args:
            newcomers: no more than there are places `yielding`; their probabilities are what
                they get, the clusters that stay share the rest in their proportions.
            step: the step after which they are tracked.
            protected_until: the step before which they may not be replaced.

        Returns:
            The new clusters, in the order of the newcomers, and who began and who ended.
        """
        free = max(self._rules.clusters - len(self._clusters), 0)
        leaving = self._make_room(len(newcomers), step)
        given = math.fsum(place.share for place, _ in newcomers)
        left = math.log1p(-given) if given < 1.0 else -math.inf
        if self._clusters:
            self._set(np.maximum(belief.normalised_logs(self._log_probabilities()) + left, -1e6))
        first = self._next_cluster
        for place, _ in newcomers:
            self._clusters[self._next_cluster] = Cluster(
                self._next_cluster,
                math.log(max(place.share, LEAST_PROBABILITY)),
                step,
                place.mean,
                place.covariance,
                protected_until,
            )
            self._next_cluster += 1
        if self._clusters:
            self._set(belief.normalised_logs(self._log_probabilities()))
        admitted = [self._clusters[number] for number in range(first, self._next_cluster)]
        events: list[JobEvent] = [
            _ended(cluster, "pushed out", admitted[min(taken, len(admitted) - 1)])
            for taken, cluster in enumerate(leaving, start=free)
        ]
        events += [
            Began(cluster.job_id, cause, cluster.probability)
            for cluster, (_, cause) in zip(admitted, newcomers, strict=True)
        ]
        return admitted, events

    def drop_improbable(self, step: int) -> list[Ended]:
        """Drop clusters under the threshold, where one is set; the best one always stays."""
        least = self._rules.drop_below_probability
        leaving = [
            cluster
            for cluster in self.by_probability()[1:]
            if cluster.probability < least and step >= cluster.protected_until
        ]
        ended = self._end(leaving, "improbable")
        if leaving:
            self._set(belief.normalised_logs(self._log_probabilities()))
        return ended

    def split(
        self, job_id: str, parts: Sequence[Place], step: int
    ) -> tuple[list[Cluster], list[JobEvent]]:
        """Put the parts of a cluster that has fallen apart in its place; they share what it had.

        Args:
            job_id: the cluster's.
            parts: two or more.
            step: the step after which they are tracked.

        Returns:
            As `admit`.
        """
        whole = self._clusters.pop(int(job_id.removeprefix("c")))
        total = math.fsum(part.share for part in parts)
        newcomers: list[Newcomer] = [
            (replace(part, share=whole.probability * part.share / total), "split") for part in parts
        ]
        admitted, events = self.admit(newcomers, step)
        return admitted, [_ended(whole, "split", *admitted), *events]

    def clear(self, cause: EndedCause) -> list[Ended]:
        """Forget all clusters."""
        return self._end(self.all(), cause)

    def _leaving(self, step: int) -> list[Cluster]:
        """Those that may be replaced, least probable first."""
        return [c for c in reversed(self.by_probability()) if step >= c.protected_until]

    def _make_room(self, count: int, step: int) -> list[Cluster]:
        """Take out as many as are too many; returns them."""
        surplus = len(self._clusters) + count - self._rules.clusters
        leaving = self._leaving(step)[: max(surplus, 0)]
        for cluster in leaving:
            del self._clusters[cluster.cluster]
        return leaving

    def _end(self, leaving: Iterable[Cluster], cause: EndedCause, *by: Cluster) -> list[Ended]:
        """Take clusters out."""
        for cluster in leaving:
            del self._clusters[cluster.cluster]
        return [_ended(cluster, cause, *by) for cluster in leaving]

    def _log_probabilities(self) -> belief.LogProbabilities:
        return np.array([cluster.log_probability for cluster in self._clusters.values()])

    def _set(self, log_probabilities: Iterable[float]) -> None:
        for cluster, value in zip(list(self._clusters.values()), log_probabilities, strict=True):
            self._clusters[cluster.cluster] = replace(cluster, log_probability=float(value))


def _ended(cluster: Cluster, cause: EndedCause, *by: Cluster) -> Ended:
    return Ended(cluster.job_id, cause, tuple(other.job_id for other in by), cluster.probability)
