"""The beam model, which compares the length of each beam with a ray cast in the map."""

from dataclasses import dataclass
from math import cos, erf, exp, log, pi, sin, sqrt
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import LogWeights, Pose, Poses
from particle_filter.grid import Grid
from particle_filter.kernels import kernel, plain, read_only, to_cells
from particle_filter.likelihood_field import LikelihoodField
from particle_filter.pyramid import Pyramid
from particle_filter.ray_casting import JumpField, cast_ray, checked_jumps, flat, jump_field
from particle_filter.sensor_model import Beams, LaserScan, MapArrays, usable_beams
from particle_filter.settings import SensorSettings

_Mixture = tuple[float, float, float, float, float, float, float]
"""Weights of hit, short, max and rand; hit_sigma_m, short_decay_per_m, max_range_m."""
_NEGLIGIBLE = 6.0
"""Number of standard deviations beyond which a Gaussian's tail, 1e-9 of it, is ignored."""


@dataclass(frozen=True, eq=False)
class BeamModel:
    """Weighs poses by the lengths of beams; see `SensorModel`."""

    beam_work: ClassVar[int] = 100

    grid: Grid
    pyramid: Pyramid
    jumps: JumpField
    settings: SensorSettings

    @classmethod
    def arrays_of(cls, grid: Grid, settings: SensorSettings) -> MapArrays:
        """Compute the jump field for rays, and the pyramid for searches."""
        field = LikelihoodField.build(grid, settings)
        return {"jumps": jump_field(grid.cells), **Pyramid.arrays_of(field)}

    @classmethod
    def from_arrays(cls, grid: Grid, arrays: MapArrays, settings: SensorSettings) -> Self:
        pyramid = Pyramid.from_arrays(arrays, grid, settings)
        return cls(grid, pyramid, checked_jumps(arrays["jumps"], grid.cells), settings)

    def beams(self, scan: LaserScan) -> Beams:
        """Choose beams, also those without return: they show that nothing was hit."""
        return scan.chosen(self._of_laser, self.settings.max_beams)

    def _of_laser(self, scan: LaserScan, max_beams: int) -> Beams:
        longest = min(scan.range_max_m, self.settings.max_range_m)
        ranges = np.minimum(np.asarray(scan.ranges, np.float64), longest)  # NaN stays NaN
        return scan.beams(ranges, usable_beams(ranges, np.inf, max_beams), longest)

    def log_likelihood(self, map_from_robot: Poses, beams: Beams) -> LogWeights:
        if not beams.others:
            return self._of_beams(map_from_robot, beams)
        seeing = [laser for laser in beams.lasers if len(laser.ranges)]
        logs = [self._of_beams(map_from_robot, laser) for laser in seeing]
        return np.asarray(np.sum(logs, axis=0))

    def _of_beams(self, map_from_robot: Poses, laser: Beams) -> LogWeights:
        return beam_log_likelihood(
            map_from_robot,
            laser.ranges,
            laser.angles,
            robot_from_laser=laser.robot_from_laser,
            grid=self.grid,
            jumps=self.jumps,
            max_range_m=laser.max_range_m,
            settings=self.settings,
        )

    def correction(
        self,
        map_from_robot: Poses,  # noqa: ARG002 - as all
        weights: NDArray[np.float64],  # noqa: ARG002 - as all
        beams: Beams,  # noqa: ARG002 - as all
        sharers: int = 1,  # noqa: ARG002 - as all
    ) -> float:
        """Return 0: the likelihood already casts every ray."""
        return 0.0


def beam_log_likelihood(
    map_from_robot: Poses,
    ranges: NDArray[np.floating],
    angles: NDArray[np.float64],
    *,
    robot_from_laser: Pose,
    grid: Grid,
    jumps: JumpField,
    max_range_m: float,
    settings: SensorSettings,
) -> LogWeights:
    """Weigh every particle by how well each beam's length fits the map from its pose.

    A beam is a mixture of four cases: it hits an obstacle of the map, is cut short by another
    object, does not return, or is random. The four weights are normalised to one. Beams are
    independent, so logarithms add. Unlike in the likelihood field, beams without return count as
    readings of `max_range_m`.

    Args:
        map_from_robot: (N, 3) poses.
        ranges: (B,) readings [m]; not finite, <= 0 or >= `max_range_m`: no return.
        angles: (B,) directions of the beams in the laser's frame [rad].
        robot_from_laser: (3,) pose of the laser on the robot.
        grid: the map.
        jumps: `ray_casting.jump_field` of its cells.
        max_range_m: the smaller of the laser's and the settings' maximum range [m].
        settings: weights and widths of the mixture.

    Returns:
        (N,) log-likelihood of the scan for each particle, not normalised.

    Raises:
        ValueError: there are no beams, a pose is not finite, or the range is not positive.

    References:
        Probabilistic Robotics (2005), table 6.1 and eq. 6.4 to 6.11, in logarithms.
    """
    if len(ranges) == 0 or len(ranges) != len(angles):
        raise ValueError(f"{len(ranges)} ranges and {len(angles)} angles cannot be scored")
    if not (max_range_m > 0 and np.isfinite(map_from_robot).all()):
        raise ValueError("beams are scored from finite poses and with a positive range")
    readings = np.asarray(ranges, np.float64)
    returned = np.isfinite(readings) & (readings > 0.0) & (readings < max_range_m)
    beams = np.empty((len(readings), 3))
    beams[:, 0], beams[:, 1] = np.cos(angles), np.sin(angles)
    beams[:, 2] = np.where(returned, readings, max_range_m)
    return _summed_logs(
        plain(map_from_robot),
        plain(beams),
        plain(robot_from_laser),
        read_only(jumps),
        (grid.cell_m, *to_cells(grid.map_from_grid, grid.cell_m)),
        _mixture(settings, max_range_m),
    )


def _mixture(settings: SensorSettings, max_range_m: float) -> _Mixture:
    weights = np.array(
        [
            settings.hit_weight,
            settings.short_weight,
            settings.max_weight,
            settings.random_weight,
        ]
    )
    hit, short, none, rand = (float(weight) for weight in weights / weights.sum())
    widths = settings.hit_sigma_m, settings.short_decay_per_m, float(max_range_m)
    return hit, short, none, rand, *widths


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
