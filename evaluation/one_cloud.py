"""The particle set of ordinary MCL, which shrinks from its initial to its final size."""

import math

import numpy as np

from particle_filter.arrays import FREE, Pose, Poses
from particle_filter.cluster_filter import MeasurementUpdate, ParticleSet, measurement_update
from particle_filter.motion import move
from particle_filter.poses import between, compose
from particle_filter.resampling import resample
from particle_filter.sensor_model import Beams, Grid, SensorModel
from particle_filter.settings import FilterSettings

START_PARTICLES_PER_M2, LEAST_START_PARTICLES, MOST_START_PARTICLES = 400.0, 50_000, 2_000_000
SHRINKING_STEPS = 6
"""Steps over which the number of particles shrinks."""
RESAMPLE_BELOW_ESS = 0.5
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


def start_particles(grid: Grid) -> int:
    """Return the number of particles for a uniform start in a map."""
    free_area_m2 = np.count_nonzero(grid.cells == FREE) * grid.cell_m**2
    wanted = round(free_area_m2 * START_PARTICLES_PER_M2)
    return min(max(wanted, LEAST_START_PARTICLES), MOST_START_PARTICLES)


def uniform_over_free_space(grid: Grid, count: int, rng: np.random.Generator) -> Poses:
    """Return poses stratified over free cells and headings.

    Args:
        grid: the map.
        count: number of poses.
        rng: places each within its stratum.

    Returns:
        (count, 3) poses.

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


class OneCloud:
    """All particles of ordinary MCL.

    Args:
        model: weighs poses.
        settings: the filter's settings.
        start: (N, 3) initial poses.
        kept: final number of particles.
    """

    def __init__(
        self, model: SensorModel, settings: FilterSettings, start: Poses, kept: int
    ) -> None:
        self._model, self._settings = model, settings
        self._start_count, self._kept = len(start), min(kept, len(start))
        self.particles = ParticleSet.even(start)
        self.steps = 0

    @property
    def shrunk(self) -> bool:
        """Whether it has shrunk to its final size."""
        return self.steps >= SHRINKING_STEPS

    def advance(
        self,
        odom_from_before: Pose | None,
        odom_from_after: Pose,
        beams: Beams,
        rng: np.random.Generator,
    ) -> MeasurementUpdate:
        """Apply one step; the first one has no motion."""
        if odom_from_before is not None:
            self._redraw(rng)
            before_from_after = between(odom_from_before, odom_from_after)
            poses, motion = self.particles.map_from_robot, self._settings.motion
            moved = move(poses, before_from_after, motion, rng)
            self.particles = ParticleSet(moved, self.particles.log_weights)
        exponent = self._model.settings.scan_likelihood_exponent
        result = measurement_update(self.particles, beams, self._model, exponent)
        self.particles = result.particles
        self.steps += 1
        return result

    def _redraw(self, rng: np.random.Generator) -> None:
        """Resample to shrink, or if the effective sample size is too small."""
        progress = min(self.steps / SHRINKING_STEPS, 1.0)
        count = round(self._start_count * (self._kept / self._start_count) ** progress)
        held = len(self.particles.log_weights)
        if count >= held and self.particles.effective_sample_size >= RESAMPLE_BELOW_ESS * held:
            return
        chosen = resample(self.particles.log_weights, count, rng)
        self.particles = ParticleSet.even(self.particles.map_from_robot[chosen])
