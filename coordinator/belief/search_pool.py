"""One global search as the coordinator sees it: its shards' places, pooled."""

import math
from dataclasses import dataclass

import msgspec
import numpy as np
from msgspec.structs import replace

from coordinator.belief.search_evidence import SearchEvidenceState
from particle_filter.overlaps import merge_overlapping
from particle_filter.settings import SearchSettings
from protocol.arrays import ArrayBlob
from protocol.message import PoseTuple
from protocol.work import Particles, Place, SearchReport

KEPT_STEPS = 16
"""Reports of so many steps are kept while shards run apart."""
_PATIENCE = 4
"""Times as long as usual a search may take while more is possible than can be tracked."""
_NO_WEIGHT = 0.01
"""What a shard with less of the evidence left out does not count."""


class SearchState(msgspec.Struct, frozen=True):
    """A search under way."""

    search: int
    first_step: int
    evidence: SearchEvidenceState
    progress: float = 0.0
    """How near it is to its end, 0 to 1."""


@dataclass(frozen=True)
class PooledPlace:
    """A place as one or several shards have found it."""

    share: float
    """Of all that the search has found."""
    views: tuple[Place, ...]
    """One of each shard, the most probable first; each with its part of the share."""

    @property
    def mean(self) -> PoseTuple:
        """Where it is: x [m], y [m], heading [rad]."""
        return self.views[0].mean

    def place(self, share: float) -> Place:
        """The place to be tracked, of so much weight: samples side by side, weighed by share."""
        best = self.views[0]
        poses = [view.sample.map_from_robot.array() for view in self.views]
        log_weights = []
        for view in self.views:
            own = view.sample.log_weights.array().astype(np.float64)
            log_weights.append(own - np.logaddexp.reduce(own) + math.log(view.share))
        sample = Particles(
            step=best.sample.step,
            odom_from_robot=best.sample.odom_from_robot,
            map_from_robot=ArrayBlob.of(np.concatenate(poses), "float64"),
            log_weights=ArrayBlob.of(np.concatenate(log_weights), "float64"),
        )
        return Place(share=share, mean=best.mean, covariance=best.covariance, sample=sample)


@dataclass(frozen=True)
class Pool:
    """All places of a search after one step, most probable first."""

    step: int
    places: tuple[PooledPlace, ...]
    log_evidence: float
    """Log of the average likelihood of all scans so far, over the whole free space."""
    left_out_gap: float
    """What the search has left out was worse than its best by so much at least [nat]."""


class SearchPool:
    """Collects the shards' reports and pools the newest step that all shards have reached."""

    def __init__(self, search: int, first_step: int, settings: SearchSettings) -> None:
        self.search, self.first_step = search, first_step
        self.progress = 0.0
        """How near the search is to its end, 0 to 1, when `finished` was asked last."""
        self._settings = settings
        self._reports: dict[int, dict[str, SearchReport]] = {}

    @property
    def job_ids(self) -> tuple[str, ...]:
        """The jobs of this search, one a shard."""
        return tuple(f"s{self.search}.{shard}" for shard in range(self._settings.shards))

    def state(self, evidence: SearchEvidenceState) -> SearchState:
        """The search as it is handed on, with what it is compared with."""
        return SearchState(self.search, self.first_step, evidence, self.progress)

    def add(self, report: SearchReport) -> None:
        """Keep one shard's report; none can tell of a step before the search began."""
        if report.step < self.first_step:
            return
        self._reports.setdefault(report.step, {})[report.job_id] = report
        while len(self._reports) > KEPT_STEPS:
            del self._reports[min(self._reports)]

    def pooled(self) -> Pool | None:
        """The newest step that every shard has reported; None if it was pooled before, or none is.

        A search that lags behind the clusters reports less often than they take steps, and to
        pool thousands of places takes longer than such a step.
        """
        shards = self._settings.shards
        complete = [step for step, reports in self._reports.items() if len(reports) == shards]
        if not complete:
            return None
        step = max(complete)
        reports = self._reports[step]
        for known in [kept for kept in self._reports if kept <= step]:
            del self._reports[known]
        return _pool(step, [reports[job] for job in self.job_ids], self._settings)

    def finished(self, pool: Pool, clusters: int, *, patient: bool = True) -> bool:
        """Whether the search need not go on: its best places hold enough, or it took too long.

        Places that hold nearly all of what was kept are not enough where poses almost as good
        were left out.

        Args:
            pool: what has been found.
            clusters: how many places can be tracked.
            patient: let it take longer while more is possible than can be tracked: the robot may
                be at any of the places that would be dropped.
        """
        mass = self._settings.converged_mass
        held = sum(place.share for place in pool.places[:clusters])
        too_many = held < mass and len(pool.places) > clusters
        most_steps = self._settings.max_steps * (_PATIENCE if patient and too_many else 1)
        steps = pool.step - self.first_step + 1
        near = max(min(held, 1.0 - math.exp(-pool.left_out_gap)) / mass, steps / most_steps)
        self.progress = min(near, 1.0)
        return near >= 1.0


def _pool(step: int, reports: list[SearchReport], settings: SearchSettings) -> Pool:
    """Weigh the shards by their evidence and join places that several of them found."""
    shards = np.array([report.log_evidence for report in reports])
    log_sum = np.logaddexp.reduce(shards)
    shard_weight, log_evidence = np.exp(shards - log_sum), float(log_sum) - math.log(len(shards))
    found = [
        replace(place, share=float(weight * place.share))
        for weight, report in zip(shard_weight, reports, strict=True)
        for place in report.places
        if weight * place.share > 0.0
    ]
    found.sort(key=lambda place: -place.share)
    gaps = [r.left_out_gap for r, w in zip(reports, shard_weight, strict=True) if w > _NO_WEIGHT]
    means = np.reshape([place.mean for place in found], (-1, 3))
    into = merge_overlapping(means, settings.source_radius_m, settings.source_heading_rad)
    groups: dict[int, list[Place]] = {}
    for index, place in zip(into.tolist(), found, strict=True):
        groups.setdefault(index, []).append(place)
    joined = [
        PooledPlace(math.fsum(view.share for view in views), tuple(views))
        for _, views in sorted(groups.items())
    ]
    joined.sort(key=lambda place: -place.share)
    return Pool(step, tuple(joined), log_evidence, min(gaps))
