"""The sensor model: the likelihood field of a map, and the beams of a scan that it weighs."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import FREE, Cells, LogWeights, Points, Pose, Poses
from clustermcl.filter.grid import Grid
from clustermcl.filter.kernels.compiled import ToCells, checked, kernel, plain
from clustermcl.filter.laser.likelihood_field import LikelihoodField, scan_log_likelihood
from clustermcl.filter.laser.pyramid import Pyramid
from clustermcl.filter.laser.ray_casting import JumpField, jump_field
from clustermcl.filter.settings import SensorSettings

MapArrays: TypeAlias = Mapping[str, NDArray[Any]]
"""Arrays that a model computes once from a map, by name; read-only, perhaps mapped from disk."""


@dataclass(frozen=True, eq=False)
class Beams:
    """The scored beams of a scan by one laser, which all returned, and those of other lasers."""

    ranges: NDArray[np.float64]
    """(B,) readings [m]."""
    angles: NDArray[np.float64]
    """(B,) directions in the laser's frame [rad]."""
    robot_from_laser: Pose
    others: tuple[Self, ...] = ()
    """Beams of the other lasers, as if measured at the same pose."""

    @property
    def lasers(self) -> "tuple[Beams, ...]":
        """The beams of each laser, this one first."""
        return (self, *self.others)

    @property
    def count(self) -> int:
        return sum(len(laser.ranges) for laser in self.lasers)

    @cached_property
    def own_hits_in_robot(self) -> Points:
        """(B, 2) ends of the beams of the first laser, in the robot's frame [m]."""
        x, y, heading = self.robot_from_laser
        directions = heading + self.angles
        return np.column_stack(
            [x + self.ranges * np.cos(directions), y + self.ranges * np.sin(directions)]
        )

    @cached_property
    def hits_in_robot(self) -> Points:
        """(count, 2) ends of the beams of all lasers, in the robot's frame [m]."""
        return np.concatenate([laser.own_hits_in_robot for laser in self.lasers])


@dataclass(frozen=True, eq=False)
class LaserScan:
    """A measured scan of one laser, and those of the robot's other lasers."""

    ranges: NDArray[np.floating]
    """(n,) [m]; not finite, not positive, `range_max_m` or longer: no return."""
    range_max_m: float
    angle_min: float
    """Direction of the first beam in the laser's frame [rad]."""
    angle_step: float
    """Angle from one beam to the next [rad]."""
    robot_from_laser: Pose
    others: tuple[Self, ...] = ()
    """Scans of the other lasers, as if measured at the same pose."""

    @property
    def angles(self) -> NDArray[np.float64]:
        """(n,) directions of the beams in the laser's frame [rad]."""
        return np.asarray(self.angle_min + self.angle_step * np.arange(len(self.ranges)))


@dataclass(frozen=True, eq=False)
class SensorModel:
    """Weighs poses in one map by how near the beams of a scan end to obstacles."""

    grid: Grid
    settings: SensorSettings
    pyramid: Pyramid
    """Bounds of the likelihood field over squares, for global searches."""
    jumps: JumpField
    """Jump field of the map; see `ray_casting`."""
    field: LikelihoodField

    @staticmethod
    def arrays_of(grid: Grid, settings: SensorSettings) -> MapArrays:
        """Compute the field's codes, their bounds over squares, and the jump field for rays.

        This may take seconds, and the result is cached on disk.

        Raises:
            ValueError: no cell is occupied; every pose would fit equally well.
        """
        field = LikelihoodField.build(grid, settings)
        pyramid = Pyramid.arrays_of(field)
        return {"codes": field.codes, "jumps": jump_field(grid.cells), **pyramid}

    @classmethod
    def from_arrays(cls, grid: Grid, arrays: MapArrays, settings: SensorSettings) -> Self:
        """Build the model from the result of `arrays_of` for the same map and settings.

        Raises:
            KeyError, ValueError: an array is missing, or is of another map.
        """
        field = LikelihoodField.from_codes(arrays["codes"], grid, settings)
        pyramid = Pyramid.from_arrays(arrays, grid, settings)
        jumps = checked(arrays["jumps"], np.uint8, (4, *grid.cells.shape))
        return cls(grid, settings, pyramid, jumps, field)

    def beams(self, scan: LaserScan) -> Beams:
        """Choose the beams to score: of each laser equally many, in all at most `max_beams`."""
        share = max(self.settings.max_beams // (1 + len(scan.others)), 1)
        others = tuple(self._of_laser(other, share) for other in scan.others)
        return replace(self._of_laser(scan, share), others=others)

    def _of_laser(self, scan: LaserScan, max_beams: int) -> Beams:
        """Choose beams within the laser's and the settings' maximum range."""
        longest = min(scan.range_max_m, self.settings.max_range_m)
        ranges = np.asarray(scan.ranges, np.float64)
        chosen = usable_beams(ranges, longest, max_beams)
        return Beams(ranges[chosen], scan.angles[chosen], scan.robot_from_laser)

    def log_likelihood(self, map_from_robot: Poses, beams: Beams) -> LogWeights:
        """Return (N,) log p(z | x), a sum over beams, without the exponent."""
        return scan_log_likelihood(map_from_robot, beams.hits_in_robot, self.field)


def computed_model(grid: Grid, settings: SensorSettings) -> SensorModel:
    """Compute the model of a map.

    Raises:
        ValueError: the map has no obstacle.
    """
    return SensorModel.from_arrays(grid, SensorModel.arrays_of(grid, settings), settings)


def usable_beams(
    ranges: NDArray[np.floating], range_max_m: float, max_beams: int
) -> NDArray[np.int64]:
    """Choose the beams to score: the valid ones, thinned evenly.

    Invalid beams are not finite, not positive, or `range_max_m` or longer.

    Returns:
        (B,) increasing indices into the (n,) `ranges` [m]; empty if no beam is valid.

    Raises:
        ValueError: `max_beams` is not positive.
    """
    if max_beams < 1:
        raise ValueError(f"max_beams must be positive, not {max_beams}")
    ranges = np.asarray(ranges)
    # NaN and infinity fail this comparison even if `range_max_m` is infinite.
    valid = ((ranges > 0.0) & (ranges < range_max_m)).nonzero()[0]
    if len(valid) <= max_beams:
        return valid
    middles = (2 * np.arange(max_beams) + 1) * len(valid) // (2 * max_beams)
    return np.asarray(valid[middles])


def ground_log_penalty(map_from_robot: Poses, grid: Grid, log_penalty: float) -> LogWeights:
    """Return (N,) `log_penalty` for poses on ground not known to be free, and 0 for others."""
    return _penalties(plain(map_from_robot), grid.cells, grid.in_cells, log_penalty)


@kernel
def _penalties(poses: Poses, cells: Cells, in_cells: ToCells, log_penalty: float) -> LogWeights:
    c, s, x0, y0 = in_cells
    rows, cols = cells.shape
    penalties = np.full(len(poses), log_penalty)
    for i in range(len(poses)):
        # Compared before int(), which rounds towards zero: just below the map is not in cell 0.
        col = c * poses[i, 0] - s * poses[i, 1] + x0
        row = s * poses[i, 0] + c * poses[i, 1] + y0
        if 0.0 <= col < cols and 0.0 <= row < rows and cells[int(row), int(col)] == FREE:
            penalties[i] = 0.0
    return penalties
