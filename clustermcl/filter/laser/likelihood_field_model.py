"""The likelihood field as a sensor model, corrected for occlusion.

The field rewards a beam that ends near an obstacle, even if a wall is in front of it. So a wrong
place among many walls may score better than the true one. Ray casting shows the difference, but
takes a hundred times longer; it is done for a few particles of each cluster.
"""

from dataclasses import dataclass
from math import ceil, cos, sin, sqrt
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import LogWeights, Points, Poses
from clustermcl.filter.grid import Grid
from clustermcl.filter.kernels.compiled import ToCells, checked, kernel, plain
from clustermcl.filter.laser.evidence_model import scan_exponent
from clustermcl.filter.laser.likelihood_field import LikelihoodField, scan_log_likelihood
from clustermcl.filter.laser.pyramid import Pyramid
from clustermcl.filter.laser.ray_casting import FlatJumps, JumpField, cast_ray, flat, jump_field
from clustermcl.filter.laser.sensor_model import (
    Beams,
    LaserScan,
    MapArrays,
    SensorModel,
    usable_beams,
)
from clustermcl.filter.resampling import systematic
from clustermcl.filter.settings import SensorSettings

OCCLUSION_MARGIN_M = 0.45
"""A beam may end this far behind the first obstacle on its ray, as map and pose have errors [m]."""
OCCLUSION_SLACK_RAD = 0.05
"""An end is occluded only if rays turned by this to either side are cut off too [rad]: if the pose
is slightly wrong, a ray along a wall may enter it for metres, but then one neighbour does not."""


@kernel
def _occluded(
    poses: Poses,
    laser: NDArray[np.float64],
    hits: Points,
    codes: NDArray[np.uint16],
    jumps: JumpField,
    in_cells: ToCells,
    margin: float,
    log_step: float,
    stride: int,
) -> NDArray[np.float64]:
    """Return (N,) scores of occluded beams; `margin` is in cells."""
    c, s, x0, y0 = in_cells
    rows, cols = jumps.shape[1], jumps.shape[2]
    sums, ahead = np.zeros(len(poses)), flat(jumps)
    # The ray itself, and one slightly to either side of it.
    back = -2.0 * OCCLUSION_SLACK_RAD
    turns = (
        (1.0, 0.0),
        (cos(OCCLUSION_SLACK_RAD), sin(OCCLUSION_SLACK_RAD)),
        (cos(back), sin(back)),
    )
    for i in range(len(poses)):
        ch, sh = cos(poses[i, 2]), sin(poses[i, 2])
        laser_x = poses[i, 0] + ch * laser[0] - sh * laser[1]
        laser_y = poses[i, 1] + sh * laser[0] + ch * laser[1]
        from_col = c * laser_x - s * laser_y + x0
        from_row = s * laser_x + c * laser_y + y0
        for j in range(i % stride, len(hits), stride):
            hit_x = poses[i, 0] + ch * hits[j, 0] - sh * hits[j, 1]
            hit_y = poses[i, 1] + sh * hits[j, 0] + ch * hits[j, 1]
            col = c * hit_x - s * hit_y + x0
            row = s * hit_x + c * hit_y + y0
            if not (0.0 <= col < cols and 0.0 <= row < rows):
                continue  # the rim has code 0
            code = codes[int(row) + 1, int(col) + 1]
            dx, dy = col - from_col, row - from_row
            share = 1.0 - margin / sqrt(dx * dx + dy * dy)  # of the ray that must be clear
            if not (code > 0 and share > 0.0):
                continue
            if _always_meets(ahead, (from_col, from_row), (dx, dy), share, turns):
                sums[i] += code * (log_step * stride)
    return sums


@kernel
def _always_meets(
    jumps: FlatJumps,
    start: tuple[float, float],
    way: tuple[float, float],
    share: float,
    turns: tuple[tuple[float, float], ...],
) -> bool:
    """Return whether a ray meets an obstacle after each of `turns`, applied one after the other."""
    dx, dy = way
    for c, s in turns:
        dx, dy = c * dx - s * dy, s * dx + c * dy
        if not cast_ray(jumps, start[0], start[1], dx, dy, share) < share:
            return False
    return True


@dataclass(frozen=True, eq=False)
class LikelihoodFieldModel(SensorModel):
    """Weighs poses by how near the beams end to obstacles; see `SensorModel`."""

    beam_work: ClassVar[int] = 1

    field: LikelihoodField

    @classmethod
    def arrays_of(cls, grid: Grid, settings: SensorSettings) -> MapArrays:
        """Compute the field's codes, their bounds over squares, and the jump field for rays."""
        field = LikelihoodField.build(grid, settings)
        pyramid = Pyramid.arrays_of(field)
        return {"codes": field.codes, "jumps": jump_field(grid.cells), **pyramid}

    @classmethod
    def from_arrays(cls, grid: Grid, arrays: MapArrays, settings: SensorSettings) -> Self:
        field = LikelihoodField.from_codes(arrays["codes"], grid, settings)
        pyramid = Pyramid.from_arrays(arrays, grid, settings)
        jumps = checked(arrays["jumps"], np.uint8, (4, *grid.cells.shape))
        return cls(grid, settings, pyramid, jumps, field)

    def _of_laser(self, scan: LaserScan, max_beams: int) -> Beams:
        """Choose beams that returned; the ends of the others are unknown."""
        longest = min(scan.range_max_m, self.settings.max_range_m)
        ranges = np.asarray(scan.ranges, np.float64)
        return scan.beams(ranges, usable_beams(ranges, longest, max_beams), longest)

    def log_likelihood(self, map_from_robot: Poses, beams: Beams) -> LogWeights:
        return scan_log_likelihood(map_from_robot, beams.hits_in_robot, self.field)

    def correction(
        self, map_from_robot: Poses, weights: NDArray[np.float64], beams: Beams, sharers: int = 1
    ) -> float:
        """Return a share of the mean score of the beams whose ends are occluded [nat].

        The field rewards a beam that ends near an obstacle even if another obstacle is in front of
        it. The mean is estimated from a systematic sample of the particles, minus a tolerance,
        because neither poses nor maps are exact.
        """
        of = self.settings
        # So many that all beams are checked equally often.
        count = of.visibility_beam_stride * ceil(
            of.visibility_particles / (of.visibility_beam_stride * sharers)
        )
        count = min(count, of.visibility_particles)
        if count == 0 or beams.count == 0:
            return 0.0
        chosen = systematic(weights, count, 0.5)
        occluded = self.occluded(map_from_robot.take(chosen, axis=0), beams)
        tolerated = of.occlusion_tolerance * beams.count
        mean = max(float(np.add.reduce(occluded)) / count - tolerated, 0.0)
        return scan_exponent(beams.count, of) * of.occlusion_weight * mean

    def occluded(self, map_from_robot: Poses, beams: Beams) -> LogWeights:
        """Return (N,) the part of each pose's `log_likelihood` from occluded beams [nat].

        An end is occluded if its ray and both neighbours of the ray meet an occupied cell more
        than `OCCLUSION_MARGIN_M` before it. Such a beam keeps the score of a random reading; the
        rest is returned. This takes a hundred times as long as `log_likelihood`. So pose i checks
        the beams i, i + stride and so on, modulo `visibility_beam_stride`, and counts them for all
        beams, because the poses of one cluster see much the same.
        """
        occluded = [
            _occluded(
                plain(map_from_robot),
                plain(laser.robot_from_laser[:2]),
                plain(laser.own_hits_in_robot),
                self.field.codes,
                self.jumps,
                self.grid.in_cells,
                OCCLUSION_MARGIN_M / self.grid.cell_m,
                self.field.log_step,
                self.settings.visibility_beam_stride,
            )
            for laser in beams.lasers
        ]
        return np.asarray(np.sum(occluded, axis=0))
