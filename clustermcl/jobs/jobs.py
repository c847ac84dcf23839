"""The kinds of jobs: track one cluster, run one shard of a global search, weigh elsewhere.

A job takes scans in the order of their steps and returns a report of each. All randomness comes
from (seed, job, step), so a job that another worker continues gives the same numbers.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec.structs import replace

from clustermcl.filter.arrays import Pose
from clustermcl.filter.cluster import cluster_filter
from clustermcl.filter.cluster.cluster_filter import ParticleSet
from clustermcl.filter.laser.beam_fits import beam_fits
from clustermcl.filter.laser.sensor_model import Beams, SensorModel
from clustermcl.filter.log_weights import multiplied
from clustermcl.filter.observations.likelihood import allowed_poses, log_ratios
from clustermcl.filter.poses import between
from clustermcl.filter.random_streams import Purpose, generator
from clustermcl.filter.search import global_search, places
from clustermcl.filter.search.uniform_poses import UniformPoses
from clustermcl.filter.settings import FilterSettings
from clustermcl.filter.slices import Slices, finished
from clustermcl.jobs.scan_arrays import (
    ScanArrays,
    motion_by_scans,
    observation_arrays,
    observed,
    scan_beams,
)
from clustermcl.protocol import work
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.found_places import FoundPlaces
from clustermcl.protocol.pose_arrays import covariance_tuple, pose_tuple
from clustermcl.protocol.steps import Scan, mirrored


class RunningJob(ABC):
    """A job with its state.

    Every `snapshot_every_steps`, if not 0, the reports of a tracked cluster have its particles.
    """

    step: int
    """The last step done."""

    def __init__(
        self,
        assignment: work.Assignment,
        model: SensorModel,
        settings: FilterSettings,
        sender: str,
        snapshot_every_steps: int,
        arrays: ScanArrays,
    ) -> None:
        self.assignment, self._model, self._settings = assignment, model, settings
        self._arrays = arrays
        self._sender, self._snapshot_every = sender, snapshot_every_steps
        self._begin(assignment.job)

    @abstractmethod
    def _begin(self, job: Any) -> None:
        """Set `step` and the state before the first scan."""

    @abstractmethod
    def advance(self, scan: Scan) -> work.Report:
        """Apply the scan of a later step, and return the report; steps may be skipped."""

    def use(self, model: SensorModel, settings: FilterSettings) -> None:
        self._model, self._settings = model, settings

    def handed_on(self) -> work.Assignment:
        """Return the job in a form from which another worker continues with the same numbers."""
        return self.assignment

    def _rng(self, purpose: Purpose, entity: int, step: int, part: int = 0) -> np.random.Generator:
        return generator(self._settings.seed, purpose=purpose, entity=entity, step=step, part=part)

    def _head(self, step: int) -> dict[str, Any]:
        job_id, epoch = self.assignment.job_id, self.assignment.epoch
        return {"sender": self._sender, "job_id": job_id, "epoch": epoch, "step": step}


def running(
    assignment: work.Assignment,
    model: SensorModel,
    settings: FilterSettings,
    *,
    sender: str,
    snapshot_every_steps: int = 0,
    arrays: ScanArrays | None = None,
) -> RunningJob:
    """Begin a job; arguments as for `RunningJob`."""
    kinds: dict[type[work.Job], type[RunningJob]] = {
        work.TrackJob: Tracking,
        work.SearchJob: Searching,
        work.ElsewhereJob: Elsewhere,
    }
    kind = kinds[type(assignment.job)]
    return kind(assignment, model, settings, sender, snapshot_every_steps, arrays or ScanArrays())


class Tracking(RunningJob):
    """The particles of one cluster."""

    def _begin(self, job: work.TrackJob) -> None:
        self.step = job.start.step
        self._cluster, self._mirrored = job.cluster, job.mirrored
        self._odom_from_robot = np.array(job.start.odom_from_robot)
        self._is_new = not job.exact
        poses = job.start.map_from_robot.array().astype(np.float64)
        log_weights = job.start.log_weights.array().astype(np.float64)
        if job.exact:
            self._particle_set = ParticleSet(poses, log_weights)
            particles = job.particles or len(poses)
        else:
            rng = self._rng(Purpose.START, job.cluster, self.step)
            particles = job.particles or self._settings.cluster.particles
            self._particle_set = cluster_filter.regularised_resample(
                poses, log_weights, particles, rng
            )
        self.size = particles, job.particles_from
        """Number of particles, and the first step that may resample to it."""

    def advance(self, scan: Scan) -> work.TrackReport:
        scan = self._arrays.once(mirrored, scan) if self._mirrored else scan
        rng = self._rng(Purpose.TRACK, self._cluster, scan.step)
        after = np.array(scan.odom_from_robot)
        model, beams = self._model, self._arrays.once(scan_beams, scan, self._model)
        particles, particles_from = self.size
        result = cluster_filter.mcl_step(
            self._particle_set,
            between(self._odom_from_robot, after),
            beams,
            model,
            self._settings.motion,
            self._settings.cluster,
            rng,
            is_first=self._is_new,
            count=particles if scan.step >= particles_from else None,
            by_scans=motion_by_scans(scan, self.step),
        )
        self._is_new = False
        self._particle_set, self._odom_from_robot, self.step = result.particles, after, scan.step
        log_observed = self._observe(scan)
        mean, covariance = self._particle_set.gaussian()
        best = result.best
        fits = b"" if best is None else beam_fits(best, beams, model, mirrored=self._mirrored)
        return work.TrackReport(
            **self._head(scan.step),
            log_weight_sum=result.log_weight_sum,
            particles=len(self._particle_set.log_weights),
            effective_sample_size=self._particle_set.effective_sample_size,
            pose=pose_tuple(mean),
            covariance=covariance_tuple(covariance),
            fits=fits,
            log_observed=log_observed,
            snapshot=self._snapshot(scan),
        )

    def _observe(self, scan: Scan) -> float:
        if not scan.observations:
            return 0.0
        poses, before = self._particle_set.map_from_robot, self._particle_set.log_weights
        ratios = log_ratios(poses, self._arrays.once(observation_arrays, scan, self._model))
        log_weights, total = multiplied(before, ratios, 1.0, np.zeros(len(poses)))
        self._particle_set = ParticleSet(poses, log_weights)
        return total - math.log(len(poses))

    def handed_on(self) -> work.Assignment:
        if self._is_new:
            return self.assignment
        particles, first_step = self.size
        job = work.TrackJob(
            cluster=self._cluster,
            start=self._particles(),
            exact=True,
            particles=particles,
            particles_from=first_step,
            mirrored=self._mirrored,
        )
        return replace(self.assignment, job=job)

    def _snapshot(self, scan: Scan) -> work.Particles | None:
        """Return the particles at every n-th step, else None; clusters take turns."""
        if not self._snapshot_every or (scan.step - self._cluster) % self._snapshot_every != 0:
            return None
        return self._particles()

    def _particles(self) -> work.Particles:
        return work.Particles(
            step=self.step,
            odom_from_robot=pose_tuple(self._odom_from_robot),
            map_from_robot=ArrayBlob.of(self._particle_set.map_from_robot, "float64"),
            log_weights=ArrayBlob.of(self._particle_set.log_weights, "float64"),
        )


class Searching(RunningJob):
    """One shard of a global search; another worker starts it again from its first scan."""

    def _begin(self, job: work.SearchJob) -> None:
        self.step, self._job = job.first_step - 1, job
        self._search = global_search.GlobalSearch(
            self._model, self._settings, job.shard, job.near, job.corners
        )
        self._odom_from_robot: Pose | None = None

    def advance(self, scan: Scan) -> work.SearchReport:
        return finished(self.slices(scan))

    def slices(self, scan: Scan) -> Slices[work.SearchReport]:
        """Like `advance`, in slices, with the present settings; the first slice sets `step`."""
        return self._slices(scan, self._model, self._settings)

    def _slices(
        self, scan: Scan, model: SensorModel, settings: FilterSettings
    ) -> Slices[work.SearchReport]:
        self._search.use(model, settings)
        scan = self._arrays.once(mirrored, scan) if self._job.mirrored else scan
        before, after = self._odom_from_robot, np.array(scan.odom_from_robot)
        beams = self._arrays.once(scan_beams, scan, model)
        rng = self._search_rng(scan.step, 1)
        self._odom_from_robot, self.step = after, scan.step
        yield from self._search.advance(before, after, beams, rng, observed(scan))
        yield
        found = yield from self._search.places(self._search_rng(scan.step, 2))
        return work.SearchReport(
            **self._head(scan.step),
            log_evidence=self._search.log_evidence,
            particles=max(self._search.poses, 1),
            left_out_gap=self._search.left_out_gap,
            places=_found(scan, found),
        )

    def _search_rng(self, step: int, use: int) -> np.random.Generator:
        return self._rng(Purpose.SEARCH, self._job.search, step, part=self._job.shard * 4 + use)


class Elsewhere(RunningJob):
    """Weighs each scan at new poses all over the free space, as evidence for elsewhere."""

    def _begin(self, job: work.ElsewhereJob) -> None:
        self.step = job.first_step - 1
        self._poses = UniformPoses(self._model.grid, self._rng(Purpose.ELSEWHERE, 0, 0, part=1))

    def advance(self, scan: Scan) -> work.ElsewhereReport:
        """Report the log of the average likelihood over the poses."""
        rng = self._rng(Purpose.ELSEWHERE, 0, scan.step)
        poses = self._poses.draw(self._settings.belief.elsewhere_poses, rng)
        beams = self._arrays.once(scan_beams, scan, self._model)
        self.step = scan.step
        result = cluster_filter.measurement_update(ParticleSet.even(poses), beams, self._model)
        log_likelihood = result.log_weight_sum - math.log(len(poses))
        log_observed, found = self._observed(scan, beams, log_likelihood, rng)
        return work.ElsewhereReport(
            **self._head(scan.step),
            log_likelihood=log_likelihood,
            log_observed=log_observed,
            seen=ArrayBlob.of(beams.hits_in_robot, "float64"),
            places=found,
        )

    def _observed(
        self, scan: Scan, beams: Beams, log_likelihood: float, rng: np.random.Generator
    ) -> tuple[float, FoundPlaces | None]:
        """Return the log evidence of the observations, and the places that also fit the scan."""
        observations, landmarks = observed(scan)
        grid = self._model.grid
        log_average = sum((e.log_average_ratio(landmarks, grid) for e in observations), 0.0)
        if not (observations and beams.count):
            return log_average, None
        model, count = self._model, self._settings.belief.elsewhere_poses
        poses, log_weights = allowed_poses(observations, landmarks, model.grid, count, rng)
        if not len(poses):
            return log_average, None
        log_weights += log_ratios(poses, self._arrays.once(observation_arrays, scan, model))
        particles = ParticleSet(poses, log_weights)
        result = cluster_filter.measurement_update(particles, beams, model)
        log_both = result.log_weight_sum - math.log(count)
        log_joint = log_both - log_likelihood
        log_observed = max(log_joint, log_average)
        found = places.places_of(result.particles, self._settings, rng)
        return log_observed, _found(scan, found, math.exp(log_joint - log_observed))

    def handed_on(self) -> work.Assignment:
        return replace(self.assignment, job=work.ElsewhereJob(first_step=self.step + 1))


def _found(scan: Scan, found: Sequence[places.FoundPlace], of_all: float = 1.0) -> FoundPlaces:
    return FoundPlaces.of(
        scan.odom_from_robot,
        [place.share * of_all for place in found],
        [place.mean for place in found],
        [place.covariance for place in found],
        [place.sample for place in found],
    )
