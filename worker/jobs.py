"""The kinds of work: track one cluster, run one shard of a global search, look elsewhere.

Each job is told of scans in the order of their steps and answers with a report. All chance
comes from (seed, job, step), so a job carried on elsewhere gives the same numbers.
"""

from typing import Protocol

import numpy as np
from msgspec.structs import replace

from particle_filter import cluster_filter, global_search, places
from particle_filter.arrays import Pose
from particle_filter.beam_classes import beam_classes
from particle_filter.cluster_filter import Cloud
from particle_filter.poses import between
from particle_filter.random_streams import Purpose, generator
from particle_filter.sensor_model import SensorModel
from particle_filter.settings import FilterSettings
from particle_filter.slices import Slices, finished
from protocol.arrays import ArrayBlob
from protocol.found_places import FoundPlaces
from protocol.pose_arrays import covariance_tuple, pose_tuple
from protocol.steps import Scan
from protocol.work import (
    Assignment,
    ElsewhereJob,
    Particles,
    Place,
    Report,
    SearchJob,
    SearchReport,
    TrackJob,
    TrackReport,
)
from worker.elsewhere import Elsewhere
from worker.scan_beams import scan_beams


class RunningJob(Protocol):
    """A job with its state."""

    assignment: Assignment
    step: int
    """The last step done."""

    def advance(self, scan: Scan) -> Report:
        """Take the scan of a later step; steps in between are lost."""

    def use(self, model: SensorModel, settings: FilterSettings) -> None:
        """Go on with other numbers from the next scan on."""

    def handed_on(self) -> Assignment:
        """The same job, from where another worker would carry on with the same numbers."""


def running(
    assignment: Assignment,
    model: SensorModel,
    settings: FilterSettings,
    *,
    sender: str,
    snapshot_every_steps: int = 0,
) -> RunningJob:
    """Begin a job.

    Args:
        assignment: what to do.
        model: the map as the sensors see it.
        settings: the filter's numbers.
        sender: the worker's name, for its reports.
        snapshot_every_steps: a tracked cluster reports its particles so often; 0: never.

    Raises:
        ValueError: the job's particles are no cloud.
    """
    match assignment.job:
        case TrackJob() as job:
            return Tracking(assignment, job, model, settings, sender, snapshot_every_steps)
        case SearchJob() as job:
            return Searching(assignment, job, model, settings, sender)
        case ElsewhereJob() as job:
            return Elsewhere(assignment, job, model, settings, sender)


class Tracking:
    """The particles of one cluster."""

    def __init__(
        self,
        assignment: Assignment,
        job: TrackJob,
        model: SensorModel,
        settings: FilterSettings,
        sender: str,
        snapshot_every_steps: int,
    ) -> None:
        self.assignment, self.step = assignment, job.start.step
        self._cluster, self._sender = job.cluster, sender
        self._model, self._settings = model, settings
        self._snapshot_every = snapshot_every_steps
        self._odom_from_robot = np.array(job.start.odom_from_robot)
        self._is_new = not job.exact
        poses = job.start.map_from_robot.array().astype(np.float64)
        log_weights = job.start.log_weights.array().astype(np.float64)
        if poses.ndim != 2 or poses.shape[1] != 3 or log_weights.shape != poses.shape[:1]:
            raise ValueError(f"no cloud: poses {poses.shape}, weights {log_weights.shape}")
        if job.exact:
            self._cloud = Cloud(poses, log_weights)
            particles = job.particles or len(poses)
        else:
            rng = generator(
                settings.seed, purpose=Purpose.START, entity=job.cluster, step=self.step
            )
            particles = job.particles or settings.cluster.particles
            rules = replace(settings.cluster, particles=particles)
            self._cloud = cluster_filter.drawn_from(poses, log_weights, rules, rng)
        self.size = particles, job.particles_from
        """Number of particles, and the first step that may resample to it."""

    def use(self, model: SensorModel, settings: FilterSettings) -> None:
        """Go on with other numbers."""
        self._model, self._settings = model, settings

    def advance(self, scan: Scan) -> TrackReport:
        """Move, weigh, and tell what the cluster makes of the scan."""
        rng = generator(
            self._settings.seed, purpose=Purpose.TRACK, entity=self._cluster, step=scan.step
        )
        after = np.array(scan.odom_from_robot)
        before_from_after = between(self._odom_from_robot, after)
        model, beams = self._model, scan_beams(scan, self._model)
        particles, particles_from = self.size
        result = cluster_filter.advanced(
            self._cloud,
            before_from_after,
            beams,
            model,
            self._settings.motion,
            self._settings.cluster,
            rng,
            is_first=self._is_new,
            particles=particles if scan.step >= particles_from else None,
        )
        self._is_new = False
        self._cloud, self._odom_from_robot, self.step = result.cloud, after, scan.step
        mean, covariance = self._cloud.gaussian()
        best = result.best
        classes = None if best is None else beam_classes(best, beams, model.grid, model.jumps)
        return TrackReport(
            sender=self._sender,
            job_id=self.assignment.job_id,
            epoch=self.assignment.epoch,
            step=scan.step,
            log_weight_sum=result.log_weight_sum,
            particles=len(self._cloud.log_weights),
            log_likelihood_per_beam=result.log_likelihood_per_beam,
            effective_sample_size=self._cloud.effective_sample_size,
            mean=pose_tuple(mean),
            covariance=covariance_tuple(covariance),
            beam_classes=classes or (0, 0, 0, 0),
            snapshot=self._snapshot(scan),
            parts=self._parts(scan, rng),
        )

    def handed_on(self) -> Assignment:
        """The same job, from its particles as they are now."""
        if self._is_new:
            return self.assignment
        particles, first_step = self.size
        job = TrackJob(
            cluster=self._cluster,
            start=self._particles(),
            exact=True,
            particles=particles,
            particles_from=first_step,
        )
        return replace(self.assignment, job=job)

    def _snapshot(self, scan: Scan) -> Particles | None:
        """The particles now and then, each cluster at steps of its own: 64 kB at a time."""
        if not self._snapshot_every or (scan.step - self._cluster) % self._snapshot_every != 0:
            return None
        return self._particles()

    def _particles(self) -> Particles:
        return Particles(
            step=self.step,
            odom_from_robot=pose_tuple(self._odom_from_robot),
            map_from_robot=ArrayBlob.of(self._cloud.map_from_robot, "float64"),
            log_weights=ArrayBlob.of(self._cloud.log_weights, "float64"),
        )

    def _parts(self, scan: Scan, rng: np.random.Generator) -> tuple[Place, ...]:
        """The places that the cluster has fallen apart into; none while it is one."""
        rules, every = self._settings.cluster, self._settings.cluster.split_every_steps
        if every == 0 or scan.step % every != 0:
            return ()
        search = self._settings.search
        found = places.places_of(self._cloud, search, rules.split_min_share, rng)
        return tuple(_place(place, scan) for place in found) if len(found) > 1 else ()


class Searching:
    """One shard of a global search."""

    def __init__(
        self,
        assignment: Assignment,
        job: SearchJob,
        model: SensorModel,
        settings: FilterSettings,
        sender: str,
    ) -> None:
        self.assignment, self.step = assignment, job.first_step - 1
        self._job, self._sender = job, sender
        self._model, self._settings = model, settings
        self._search = global_search.GlobalSearch(model, settings, job.shard, job.near, job.corners)
        self._odom_from_robot: Pose | None = None

    def use(self, model: SensorModel, settings: FilterSettings) -> None:
        """Go on with other numbers; the slices of a scan that have begun keep theirs."""
        self._model, self._settings = model, settings

    def handed_on(self) -> Assignment:
        """The same job: a search is carried on from its first scan."""
        return self.assignment

    def _rng(self, step: int, use: int) -> np.random.Generator:
        part = self._job.shard * 4 + use
        return generator(
            self._settings.seed,
            purpose=Purpose.SEARCH,
            entity=self._job.search,
            step=step,
            part=part,
        )

    def advance(self, scan: Scan) -> SearchReport:
        """Move, weigh, and tell the places that are possible."""
        return finished(self.slices(scan))

    def slices(self, scan: Scan) -> Slices[SearchReport]:
        """As `advance`, in slices; the step counts as done from the first on."""
        self._search.use(self._model, self._settings)
        before, after = self._odom_from_robot, np.array(scan.odom_from_robot)
        beams, rng = scan_beams(scan, self._model), self._rng(scan.step, 1)
        self._odom_from_robot, self.step = after, scan.step
        per_beam = yield from self._search.slices(before, after, beams, rng)
        yield
        found = yield from self._search.place_slices(self._rng(scan.step, 2))
        return SearchReport(
            sender=self._sender,
            job_id=self.assignment.job_id,
            epoch=self.assignment.epoch,
            step=scan.step,
            log_evidence=self._search.log_evidence,
            particles=max(self._search.poses, 1),
            left_out_gap=self._search.left_out_gap,
            log_likelihood_per_beam=per_beam,
            places=FoundPlaces.of(
                scan.odom_from_robot,
                [place.share for place in found],
                [place.mean for place in found],
                [place.covariance for place in found],
                [place.sample for place in found],
            ),
        )


def _place(place: places.FoundPlace, scan: Scan) -> Place:
    sample = place.sample
    return Place(
        share=place.share,
        mean=pose_tuple(place.mean),
        covariance=covariance_tuple(place.covariance),
        sample=Particles(
            step=scan.step,
            odom_from_robot=scan.odom_from_robot,
            map_from_robot=ArrayBlob.of(sample, "float32"),
            log_weights=ArrayBlob.of(np.zeros(len(sample)), "float32"),
        ),
    )
