"""Ordinary and augmented MCL as baselines, built from Cluster-MCL's components.

One particle set starts over the whole free space, shrinks to the number of particles that all
clusters of Cluster-MCL have together, and is never restarted. The reported places are clusters of
its particles, as in nav2.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from clustermcl.belief.outcome import Outcome
from clustermcl.filter.arrays import FREE, Pose, Poses
from clustermcl.filter.cluster.cluster_filter import (
    ParticleSet,
    measurement_update,
    regularised_resample,
)
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.sensor_model import Beams, SensorModel
from clustermcl.filter.motion.model import move, standard_normals
from clustermcl.filter.poses import between, compose
from clustermcl.filter.random_streams import Purpose, generator
from clustermcl.filter.resampling import resample
from clustermcl.filter.search.places import FoundPlace, places_of
from clustermcl.filter.settings import FilterSettings
from clustermcl.jobs.scan_arrays import motion_by_scans, scan_beams
from clustermcl.protocol.answers import Hypothesis
from clustermcl.protocol.pose_arrays import covariance_tuple, pose_tuple
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.work import Place

START_PARTICLES_PER_M2, LEAST_START_PARTICLES, MOST_START_PARTICLES = 400.0, 50_000, 2_000_000
SHRINKING_STEPS = 6
"""Number of steps over which the number of particles shrinks."""
RESAMPLE_BELOW_ESS = 0.5
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
_LOWEST_LOG = -700.0
"""The logarithm of the smallest likelihood that differs from 0."""


@dataclass(frozen=True)
class RecoveryGains:
    """Gains per step of the slow and the fast running average of the likelihood."""

    slow: float
    fast: float


AMCL_GAINS = RecoveryGains(slow=0.001, fast=0.1)
"""The values that Beluga and nav2 recommend."""


@dataclass
class Recovery:
    """Augmented MCL: random particles while scans fit worse than before.

    References:
        Probabilistic Robotics (2005), table 8.3, with its `w_slow` and `w_fast`.
    """

    gains: RecoveryGains
    _slow: float | None = None
    _fast: float = 0.0

    def on_likelihood(self, log_average_likelihood: float) -> None:
        """Update the averages with the log of a scan's mean likelihood over the particles."""
        average = math.exp(max(log_average_likelihood, _LOWEST_LOG))
        if self._slow is None:
            self._slow = self._fast = average
            return
        self._slow += self.gains.slow * (average - self._slow)
        self._fast += self.gains.fast * (average - self._fast)

    @property
    def random_share(self) -> float:
        """Share of the particles to draw uniformly; 0 before the first scan."""
        return max(0.0, 1.0 - self._fast / self._slow) if self._slow else 0.0


def start_particles(grid: Grid) -> int:
    free_area_m2 = np.count_nonzero(grid.cells == FREE) * grid.cell_m**2
    wanted = round(free_area_m2 * START_PARTICLES_PER_M2)
    return min(max(wanted, LEAST_START_PARTICLES), MOST_START_PARTICLES)


def kept_particles(settings: FilterSettings) -> int:
    """Return the number of particles that all clusters of Cluster-MCL have together."""
    each = settings.belief.max_clusters * settings.cluster.particles
    return settings.belief.particles or each


def uniform_over_free_space(grid: Grid, count: int, rng: np.random.Generator) -> Poses:
    """Return (count, 3) poses stratified over free cells and headings.

    Raises:
        ValueError: the map has no free cell.
    """
    free = np.flatnonzero(grid.cells == FREE)
    if len(free) == 0:
        raise ValueError("the map has no free cell to search")
    strata = np.arange(count)
    position = (strata + rng.random(count)) / count * len(free)
    chosen = free[np.minimum(position.astype(np.int64), len(free) - 1)]
    rows, cols = np.divmod(chosen, grid.cells.shape[1])
    in_grid = np.empty((count, 3))
    in_grid[:, 0] = (cols + rng.random(count)) * grid.cell_m
    in_grid[:, 1] = (rows + rng.random(count)) * grid.cell_m
    turns = strata * _GOLDEN + rng.random()
    in_grid[:, 2] = 2.0 * math.pi * (turns - np.floor(turns)) - math.pi
    return compose(grid.map_from_grid, in_grid)


class OrdinaryMCL:
    """One particle set for the whole map.

    Args:
        model: weighs poses.
        settings: the filter's settings.
        gains: draws random particles by these gains; None: never.
        kept: number of particles once it has shrunk; 0: `kept_particles`.
    """

    def __init__(
        self,
        model: SensorModel,
        settings: FilterSettings,
        gains: RecoveryGains | None = None,
        kept: int = 0,
    ) -> None:
        self._model, self._settings = model, settings
        self._recovery = Recovery(gains) if gains else None
        self._start_count = start_particles(model.grid)
        self.kept = min(kept or kept_particles(settings), self._start_count)
        self.particles: ParticleSet | None = None
        """The particles after the last step; None before the first."""
        self.steps = 0
        self._odom_from_robot: Pose = np.zeros(3)

    def set_pose(self, given: Place) -> None:
        """Replace all particles by those of a given pose, as nav2 does; it has no scan yet."""
        sample = given.sample
        rng = generator(self._settings.seed, purpose=Purpose.START, entity=0, step=sample.step)
        poses = sample.map_from_robot.array().astype(np.float64)
        even = np.zeros(len(poses))
        self.particles = regularised_resample(poses, even, self.kept, rng)
        self._start_count, self.steps = self.kept, SHRINKING_STEPS
        if self._recovery:
            self._recovery = Recovery(self._recovery.gains)
        self._odom_from_robot = np.array(sample.odom_from_robot)

    def advance(self, scan: Scan) -> Outcome:
        """Apply one step, and return the belief after it."""
        settings, grid = self._settings, self._model.grid
        rng = generator(settings.seed, purpose=Purpose.SEARCH, entity=0, step=scan.step)
        before, self._odom_from_robot = self._odom_from_robot, np.array(scan.odom_from_robot)
        if self.particles is None:
            start = uniform_over_free_space(grid, self._start_count, rng)
            particles = ParticleSet.even(start)
        else:
            particles = self._shrunk(self.redrawn(self.particles, rng), rng)
            motion = between(before, self._odom_from_robot)
            noise = standard_normals(rng, 3, len(particles.map_from_robot))
            by_scans = motion_by_scans(scan, scan.step - 1)
            moved = move(particles.map_from_robot, motion, settings.motion, noise, by_scans)
            particles = ParticleSet(moved, particles.log_weights)
        self.particles = self._weighed(particles, scan_beams(scan, self._model))
        self.steps += 1
        return _outcome(scan, places_of(self.particles, settings, rng), settings)

    def _weighed(self, particles: ParticleSet, beams: Beams) -> ParticleSet:
        result = measurement_update(particles, beams, self._model)
        if self._recovery:
            count = len(particles.log_weights)
            self._recovery.on_likelihood(result.log_weight_sum - math.log(count))
        return result.particles

    def redrawn(
        self, particles: ParticleSet, rng: np.random.Generator, count: int | None = None
    ) -> ParticleSet:
        """Resample, with random particles if they are due, to a number of particles.

        None: keep the number, and change nothing unless random particles are due.
        """
        share = self._recovery.random_share if self._recovery else 0.0
        if share == 0.0 and count is None:
            return particles
        count = count or len(particles.log_weights)
        poses = particles.map_from_robot[resample(particles.log_weights, count, rng)]
        random = np.flatnonzero(rng.random(count) < share)
        if len(random):
            poses[random] = uniform_over_free_space(self._model.grid, len(random), rng)
        return ParticleSet.even(poses)

    def _shrunk(self, particles: ParticleSet, rng: np.random.Generator) -> ParticleSet:
        """Resample to shrink the set, or at a small effective sample size; else do nothing."""
        progress = min(self.steps / SHRINKING_STEPS, 1.0)
        count = round(self._start_count * (self.kept / self._start_count) ** progress)
        if count >= len(particles.log_weights) and not is_degenerate(particles):
            return particles
        chosen = resample(particles.log_weights, count, rng)
        return ParticleSet.even(particles.map_from_robot[chosen])


def is_degenerate(particles: ParticleSet) -> bool:
    return particles.effective_sample_size < RESAMPLE_BELOW_ESS * len(particles.log_weights)


def outcomes(
    scans: Iterable[Scan],
    model: SensorModel,
    settings: FilterSettings,
    gains: RecoveryGains | None = None,
    filter_class: type[OrdinaryMCL] = OrdinaryMCL,
) -> Iterator[tuple[Scan, Outcome]]:
    """Yield the belief after every step; arguments as for `OrdinaryMCL`."""
    mcl = filter_class(model, settings, gains)
    for scan in scans:
        yield scan, mcl.advance(scan)


def _outcome(scan: Scan, places: list[FoundPlace], settings: FilterSettings) -> Outcome:
    hypotheses = tuple(
        Hypothesis(
            cluster=index,
            probability=place.share,
            log_probability=float(np.log(place.share)),
            pose=pose_tuple(place.mean),
            covariance=covariance_tuple(place.covariance),
            effective_sample_size=0.0,
            age_steps=0,
        )
        for index, place in enumerate(places)
    )
    sure = bool(places) and places[0].share >= settings.belief.localized_probability
    return Outcome(
        step=scan.step,
        state="localized" if sure else "ambiguous" if places else "searching",
        hypotheses=hypotheses,
        elsewhere_probability=0.0,
        searching=False,
        missing=(),
        begin={},
        events=(),
    )
