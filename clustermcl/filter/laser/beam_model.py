"""The beam model, which compares the length of each beam with a ray cast in the map."""

from dataclasses import dataclass
from math import cos, erf, exp, log, pi, sin, sqrt
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import LogWeights, Pose, Poses
from clustermcl.filter.grid import Grid
from clustermcl.filter.kernels.compiled import kernel, plain
from clustermcl.filter.laser.likelihood_field import LikelihoodField
from clustermcl.filter.laser.pyramid import Pyramid
from clustermcl.filter.laser.ray_casting import JumpField, cast_ray, flat, jump_field
from clustermcl.filter.laser.sensor_model import (
    Beams,
    LaserScan,
    MapArrays,
    SensorModel,
    usable_beams,
)
from clustermcl.filter.settings import SensorSettings

_Mixture = tuple[float, float, float, float, float, float, float]
"""Weights of hit, short, max and rand; hit_sigma_m, short_decay_per_m, max_range_m."""
_NEGLIGIBLE = 6.0
"""Number of standard deviations beyond which a Gaussian's tail, 1e-9 of it, is ignored."""


@dataclass(frozen=True, eq=False)
class BeamModel(SensorModel):
    """Weighs poses by the lengths of beams; see `SensorModel`."""

    beam_work: ClassVar[int] = 100

    @classmethod
    def arrays_of(cls, grid: Grid, settings: SensorSettings) -> MapArrays:
        """Compute the jump field for rays, and the pyramid for searches."""
        field = LikelihoodField.build(grid, settings)
        return {"jumps": jump_field(grid.cells), **Pyramid.arrays_of(field)}

    def _of_laser(self, scan: LaserScan, max_beams: int) -> Beams:
        """Choose beams, also those without return: they show that nothing was hit."""
        longest = min(scan.range_max_m, self.settings.max_range_m)
        ranges = np.minimum(np.asarray(scan.ranges, np.float64), longest)  # NaN stays NaN
        return scan.beams(ranges, usable_beams(ranges, np.inf, max_beams), longest)

    def log_likelihood(self, map_from_robot: Poses, beams: Beams) -> LogWeights:
        """Weigh every particle by how well the length of each beam fits the map from its pose.

        A beam is a mixture of four cases: it hits an obstacle of the map, is cut short by another
        object, does not return, or is random. The four weights are normalised to one. Beams are
        independent, so logarithms add. Unlike in the likelihood field, beams without return count
        as readings of `max_range_m`.

        Raises:
            ValueError: there are no beams, or a pose is not finite.

        References:
            Probabilistic Robotics (2005), table 6.1 and eq. 6.4 to 6.11, in logarithms.
        """
        if not (beams.count and np.isfinite(map_from_robot).all()):
            raise ValueError("one beam at least is scored, from finite poses")
        logs = [
            _summed_logs(
                plain(map_from_robot),
                np.column_stack([np.cos(laser.angles), np.sin(laser.angles), laser.ranges]),
                plain(laser.robot_from_laser),
                self.jumps,
                (self.grid.cell_m, *self.grid.in_cells),
                self._mixture(laser.max_range_m),
            )
            for laser in beams.lasers
            if len(laser.ranges)
        ]
        return np.asarray(np.sum(logs, axis=0))

    def _mixture(self, max_range_m: float) -> _Mixture:
        of = self.settings
        weights = np.array([of.hit_weight, of.short_weight, of.max_weight, of.random_weight])
        hit, short, none, rand = (weights / weights.sum()).tolist()
        return hit, short, none, rand, of.hit_sigma_m, of.short_decay_per_m, max_range_m

    def correction(self, *_: object) -> float:
        """Return 0: the likelihood already casts every ray."""
        return 0.0


@kernel
def _summed_logs(
    poses: Poses,
    beams: NDArray[np.float64],
    robot_from_laser: Pose,
    jumps: JumpField,
    grid: tuple[float, float, float, float, float],
    mixture: _Mixture,
) -> LogWeights:
    cell_m, c, s, x0, y0 = grid
    max_cells = mixture[6] / cell_m
    total, ahead = np.zeros(len(poses)), flat(jumps)
    for i in range(len(poses)):
        ch, sh = cos(poses[i, 2]), sin(poses[i, 2])
        x = poses[i, 0] + ch * robot_from_laser[0] - sh * robot_from_laser[1]
        y = poses[i, 1] + sh * robot_from_laser[0] + ch * robot_from_laser[1]
        col, row = c * x - s * y + x0, s * x + c * y + y0
        ch = cos(poses[i, 2] + robot_from_laser[2])
        sh = sin(poses[i, 2] + robot_from_laser[2])
        ch, sh = (c * ch - s * sh) * cell_m, (s * ch + c * sh) * cell_m  # in the grid's frame
        for j in range(len(beams)):
            dx = ch * beams[j, 0] - sh * beams[j, 1]
            dy = sh * beams[j, 0] + ch * beams[j, 1]
            length = cast_ray(ahead, col, row, dx, dy, max_cells)
            expected = min(length * cell_m, mixture[6])
            total[i] += log(beam_density(beams[j, 2], expected, mixture))
    return total


@kernel
def beam_density(measured: float, expected: float, mixture: _Mixture) -> float:
    """Return the density of a reading [1/m], given the range in the map [m].

    A reading of the largest range includes the probability of no return, a point mass, as in the
    book. Unlike there, it also has the uniform part, so that no density is zero.
    """
    hit_weight, short_weight, max_weight, rand_weight, sigma, decay, longest = mixture
    density = 0.0  # of a hit: eq. 6.4 to 6.6, of a beam cut short: eq. 6.7 to 6.9
    off = (measured - expected) / sigma
    if abs(off) < 5.0 * _NEGLIGIBLE:
        inside = 1.0  # share of the Gaussian between 0 and the largest range
        to_far, to_near = (longest - expected) / sigma, expected / sigma
        if min(to_far, to_near) < _NEGLIGIBLE:
            inside = 0.5 * (erf(to_far / sqrt(2.0)) + erf(to_near / sqrt(2.0)))
        density = hit_weight * exp(-0.5 * off * off) / (sqrt(2.0 * pi) * sigma * inside)
    if measured <= expected:
        density += short_weight * decay * exp(-decay * measured) / -np.expm1(-decay * expected)
    if measured >= longest:
        density += max_weight  # eq. 6.10
    return density + rand_weight / longest  # eq. 6.11
