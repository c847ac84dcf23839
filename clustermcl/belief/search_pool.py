"""The places of one global search, pooled from the reports of its shards."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from clustermcl.belief.overlaps import merge_overlapping
from clustermcl.belief.part import FEW, Part, Text
from clustermcl.filter.arrays import Poses
from clustermcl.filter.settings import FilterSettings, SearchSettings, Share
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.found_places import FoundPlaces
from clustermcl.protocol.message import NumberOrNone, PoseTuple
from clustermcl.protocol.pose_arrays import covariance_tuple, pose_tuple
from clustermcl.protocol.work import Particles, Place, SearchReport

KEPT_STEPS = 16
"""Steps whose reports are kept while shards are at different steps: those that the slowest shard
reaches next. Of the newest ones, a shard that is further behind would reach none in time."""
_PATIENCE = 4
"""Factor on the maximum length of a search while not all its places can be tracked."""
_NO_WEIGHT = 0.01
"""Least weight of a shard whose left-out poses count."""


@dataclass(frozen=True)
class Views:
    """V places of all shards in one table, most probable first."""

    odom_from_robot: PoseTuple
    share: NDArray[np.float64]
    """(V,) shares of the whole search."""
    mean: Poses
    """(V, 3) mean poses."""
    covariance: NDArray[np.float64]
    """(V, 9) covariances, by rows."""
    begin: NDArray[np.int64]
    """(V,) index of the first particle."""
    count: NDArray[np.int64]
    """(V,) number of particles."""
    particles: NDArray[np.float32]
    """(S, 3) particles of all views."""


@dataclass(frozen=True)
class Pool:
    """All P places of a search after one step, most probable first."""

    step: int
    share: tuple[float, ...]
    """Share of each place of the whole search."""
    rows: tuple[Sequence[int], ...]
    """Rows of `views` that belong to each place, most probable first."""
    views: Views
    left_out_gap: float
    """Least difference in log-likelihood between the best pose and the discarded ones [nat]."""

    @cached_property
    def mean(self) -> Poses:
        """(P, 3) mean pose of each place: the mean of its most probable view."""
        return self.views.mean[[rows[0] for rows in self.rows]]

    def place(self, index: int, share: float) -> Place:
        """Return a place to track with this share, with the samples of all its views."""
        views, rows = self.views, self.rows[index]
        poses, log_weights = [], []
        for row in rows:
            begin, even = views.begin[row], np.zeros(views.count[row])
            poses.append(views.particles[begin : begin + len(even)])
            log_weights.append(even - np.logaddexp.reduce(even) + math.log(views.share[row]))
        sample = Particles(
            step=self.step,
            odom_from_robot=views.odom_from_robot,
            map_from_robot=ArrayBlob.of(np.concatenate(poses), "float64"),
            log_weights=ArrayBlob.of(np.concatenate(log_weights), "float64"),
        )
        mean, covariance = pose_tuple(self.mean[index]), covariance_tuple(views.covariance[rows[0]])
        return Place(share=share, pose=mean, covariance=covariance, sample=sample)


class SearchPool(Part):
    """Collects the shards' reports and pools the newest step that all shards have reached."""

    local: ClassVar = frozenset({"reports", "reached"})
    job_ids: Annotated[tuple[Text, ...], FEW] = ()
    """The jobs of the search, one for each shard; none: no search is running."""
    first_step: NumberOrNone = 0
    """The first step whose scan it uses."""
    progress: Share = 0.0
    """Progress of the search at the last call of `finished`."""
    reports: dict[int, dict[str, SearchReport]] = {}
    reached: dict[str, int] = {}
    """The step that each shard has reported last."""

    def add(self, report: SearchReport) -> None:
        """Keep the report of a shard, unless its step is before the search."""
        if report.step < self.first_step:
            return
        self.reached[report.job_id] = report.step
        self.reports.setdefault(report.step, {})[report.job_id] = report
        done = max(self._complete(), default=0)
        for step in [step for step in self.reports if step < done or self._is_passed(step)]:
            del self.reports[step]
        while len(self.reports) > KEPT_STEPS:
            del self.reports[max(self.reports)]

    def _complete(self) -> list[int]:
        """Return the kept steps that every shard has reported."""
        shards = len(self.job_ids)
        return [step for step, reports in self.reports.items() if len(reports) == shards]

    def _is_passed(self, step: int) -> bool:
        """Return whether a shard has reported a later step without this one."""
        absent = self.reached.keys() - self.reports[step].keys()
        return any(self.reached[job_id] > step for job_id in absent)

    def pooled(self, rules: SearchSettings) -> Pool | None:
        """Return the pool of the newest step that every shard has reported, weighed by evidence.

        Each step is pooled once, because pooling thousands of places takes longer than a step.

        Returns:
            None if there is no such step since the last call.
        """
        if not (complete := self._complete()):
            return None
        step = max(complete)
        reports = [self.reports[step][job_id] for job_id in self.job_ids]
        for known in [kept for kept in self.reports if kept <= step]:
            del self.reports[known]
        shards = np.array([report.log_evidence for report in reports])
        weights = np.exp(shards - np.logaddexp.reduce(shards))
        gaps = [r.left_out_gap for r, w in zip(reports, weights, strict=True) if w > _NO_WEIGHT]
        return pool_of(step, [report.places for report in reports], weights, rules, min(gaps))

    def finished(self, pool: Pool, settings: FilterSettings, *, patient: bool) -> bool:
        """Return whether the search is over: its best places weigh enough, or it took too long.

        The weight is not enough if the search discarded poses that are almost as good.

        Args:
            pool: the places of the newest step.
            settings: contain the weight that is enough, and maxima of steps and tracked places.
            patient: let it take longer while it has more places than can be tracked, as the robot
                may be at one that would be dropped.
        """
        rules, clusters = settings.search, settings.belief.max_clusters
        mass, held = rules.converged_mass, sum(pool.share[:clusters])
        too_many = held < mass and len(pool.share) > clusters
        most_steps = rules.max_steps * (_PATIENCE if patient and too_many else 1)
        steps = pool.step - self.first_step + 1
        near = max(min(held, 1.0 - math.exp(-pool.left_out_gap)) / mass, steps / most_steps)
        self.progress = min(near, 1.0)
        return near >= 1.0


def pool_of(
    step: int,
    found: Sequence[FoundPlaces],
    weights: NDArray[np.float64],
    settings: SearchSettings,
    left_out_gap: float = math.inf,
) -> Pool:
    """Merge lists of found places into one pool; each list's shares are scaled by its weight."""
    views = _views(found, weights)
    into = merge_overlapping(views.mean, *settings.reach)
    groups: dict[int, list[int]] = {}
    for row, first in enumerate(into.tolist()):
        groups.setdefault(first, []).append(row)
    shares = views.share.tolist()
    joined = [(math.fsum(shares[row] for row in rows), rows) for _, rows in sorted(groups.items())]
    joined.sort(key=lambda place: -place[0])
    share, rows = tuple(share for share, _ in joined), tuple(rows for _, rows in joined)
    return Pool(step, share, rows, views, left_out_gap)


def _views(found: Sequence[FoundPlaces], shard_weight: NDArray[np.float64]) -> Views:
    """Return the places of all shards with a positive share."""
    share = np.concatenate(
        [weight * one.share.array() for weight, one in zip(shard_weight, found, strict=True)]
    )
    count = np.concatenate([one.count.array().astype(np.int64) for one in found])
    known = np.flatnonzero(share > 0.0)
    order = known[np.argsort(-share[known], kind="stable")]
    return Views(
        odom_from_robot=found[0].odom_from_robot,
        share=share[order],
        mean=np.concatenate([one.mean.array() for one in found])[order],
        covariance=np.concatenate([one.covariance.array() for one in found])[order],
        begin=(np.cumsum(count) - count)[order],
        count=count[order],
        particles=np.concatenate([one.particles.array() for one in found]),
    )
