"""The likelihood field as a sensor model, corrected for beams that would pass through walls."""

from dataclasses import dataclass
from math import ceil
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import LogWeights, Poses
from particle_filter.likelihood_field import LikelihoodField, scan_log_likelihood
from particle_filter.pyramid import Pyramid
from particle_filter.ray_casting import JumpField, checked_jumps, jump_field
from particle_filter.resampling import systematic
from particle_filter.sensor_model import Beams, Grid, LaserScan, MapArrays, usable_beams
from particle_filter.settings import SensorSettings
from particle_filter.visibility import occluded_log_likelihood

OCCLUSION_MARGIN_M = 0.45
"""A beam may end this far behind the first obstacle on its ray [m]."""
OCCLUSION_SLACK_RAD = 0.05
"""An end is occluded only if rays turned by this to either side are cut off too [rad]."""


@dataclass(frozen=True, eq=False)
class LikelihoodFieldModel:
    """Weighs poses by how near the beams end to obstacles; see `SensorModel`."""

    beam_work: ClassVar[int] = 1

    grid: Grid
    field: LikelihoodField
    pyramid: Pyramid
    jumps: JumpField
    settings: SensorSettings

    @classmethod
    def arrays_of(cls, grid: Grid, settings: SensorSettings) -> MapArrays:
        """Compute the field's codes, their bounds over squares, and jumps of rays."""
        field = LikelihoodField.build(grid.cells, grid.cell_m, grid.map_from_grid, settings)
        pyramid = Pyramid.arrays_of(field)
        return {"codes": field.codes, "jumps": jump_field(grid.cells), **pyramid}

    @classmethod
    def from_arrays(cls, grid: Grid, arrays: MapArrays, settings: SensorSettings) -> Self:
        """Build the model from the result of `arrays_of`."""
        field = LikelihoodField.from_codes(
            arrays["codes"], grid.cells, grid.cell_m, grid.map_from_grid, settings
        )
        pyramid = Pyramid.from_arrays(arrays, grid.cells, grid.cell_m, settings)
        return cls(grid, field, pyramid, checked_jumps(arrays["jumps"], grid.cells), settings)

    def beams(self, scan: LaserScan) -> Beams:
        """Choose beams that returned; the ends of the others are unknown."""
        return scan.chosen(self._of_laser, self.settings.max_beams)

    def _of_laser(self, scan: LaserScan, max_beams: int) -> Beams:
        longest = min(scan.range_max_m, self.settings.max_range_m)
        ranges = np.asarray(scan.ranges, np.float64)
        return scan.beams(ranges, usable_beams(ranges, longest, max_beams), longest)

    def log_likelihood(self, map_from_robot: Poses, beams: Beams) -> LogWeights:
        """Return (N,) log p(z | x), a sum over beams, without the exponent."""
        return scan_log_likelihood(map_from_robot, beams.hits_in_robot, self.field)

    def correction(
        self, map_from_robot: Poses, weights: NDArray[np.float64], beams: Beams, sharers: int = 1
    ) -> float:
        """Return the share of the occluded beams' score that the evidence loses."""
        settings = self.settings
        taken_back = settings.scan_likelihood_exponent * settings.occlusion_weight
        return taken_back * self.mean_occluded(map_from_robot, weights, beams, sharers)

    def mean_occluded(
        self, map_from_robot: Poses, weights: NDArray[np.float64], beams: Beams, sharers: int = 1
    ) -> float:
        """Return the mean score of beams whose ends are occluded from the particles.

        The field rewards a beam that ends near an obstacle even if another obstacle is in front of
        it. The mean is estimated from a systematic sample of the particles, minus a tolerance,
        because neither poses nor maps are exact.
        """
        count, tolerance = self._looked_from(sharers), self.settings.occlusion_tolerance
        if count == 0 or beams.count == 0:
            return 0.0
        chosen = systematic(weights, count)
        occluded = self.occluded(map_from_robot.take(chosen, axis=0), beams)
        return max(float(np.add.reduce(occluded)) / count - tolerance * beams.count, 0.0)

    def _looked_from(self, sharers: int) -> int:
        """Number of sampled particles for each sharer; all beams are checked equally often."""
        whole, stride = self.settings.visibility_particles, self.settings.visibility_beam_stride
        return min(stride * ceil(whole / (stride * sharers)), whole)

    def occluded(self, map_from_robot: Poses, beams: Beams) -> LogWeights:
        """Return (N,) the part of `log_likelihood` of occluded beams; each pose checks some beams.

        It takes a hundred times as long as the field.
        """
        occluded = self._occluded_of_laser(map_from_robot, beams)
        for other in beams.others:
            occluded += self._occluded_of_laser(map_from_robot, other)
        return occluded

    def _occluded_of_laser(self, map_from_robot: Poses, laser: Beams) -> LogWeights:
        return occluded_log_likelihood(
            map_from_robot,
            laser.robot_from_laser[:2],
            laser.own_hits_in_robot,
            self.field,
            self.jumps,
            OCCLUSION_MARGIN_M,
            OCCLUSION_SLACK_RAD,
            self.settings.visibility_beam_stride,
        )
