"""What every sensor model does: choose beams of a scan, weigh poses by them, correct the sum.

A model is a class in a file of its own; `sensor_models.py` knows them all by their names.
"""

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Protocol, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import Cells, LogWeights, Points, Pose, Poses
from particle_filter.kernel_arguments import ToCells, read_only, to_cells
from particle_filter.pyramid import Pyramid
from particle_filter.ray_casting import JumpField
from particle_filter.scan_points import points_in_robot
from particle_filter.settings import SensorSettings

MapArrays: TypeAlias = Mapping[str, NDArray[Any]]
"""What a model computes once of a map, by name; never written again, perhaps mapped from disk."""


@dataclass(frozen=True, eq=False)
class Grid:
    """The map, and where it lies."""

    cells: Cells
    """(rows, cols); row 0 has the lowest y."""
    cell_m: float
    """Side of a cell [m]."""
    map_from_grid: Pose
    """(3,) the outer corner of cell (0, 0), in the map's frame."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "cells", read_only(self.cells))

    @cached_property
    def in_cells(self) -> ToCells:
        """What carries a point of the map to cells of the grid."""
        return to_cells(self.map_from_grid, self.cell_m)


@dataclass(frozen=True, eq=False)
class Beams:
    """The beams of one scan that are scored: one laser's, and those of the others."""

    ranges: NDArray[np.float64]
    """(B,) readings [m]; `max_range_m` or longer: no return."""
    angles: NDArray[np.float64]
    """(B,) directions in the laser's frame [rad]."""
    robot_from_laser: Pose
    max_range_m: float
    """The shorter of what the laser and the settings can see."""
    others: tuple[Self, ...] = ()
    """Of the robot's other lasers, as at the same pose; they have no others."""

    @property
    def lasers(self) -> "tuple[Beams, ...]":
        """The beams laser by laser: each laser's start where it is."""
        return (self, *self.others)

    @property
    def count(self) -> int:
        """How many beams, of all lasers."""
        return sum(len(laser.ranges) for laser in self.lasers)

    @cached_property
    def own_hits_in_robot(self) -> Points:
        """(B, 2) where those of the first laser ended."""
        return points_in_robot(self.ranges, self.angles, self.robot_from_laser)

    @cached_property
    def returned(self) -> NDArray[np.bool_]:
        """(count,) which of all ended somewhere."""
        return np.concatenate([laser.ranges < laser.max_range_m for laser in self.lasers])

    @cached_property
    def hits_in_robot(self) -> Points:
        """(count, 2) where all ended."""
        if not self.others:
            return self.own_hits_in_robot
        return np.concatenate([laser.own_hits_in_robot for laser in self.lasers])


@dataclass(frozen=True, eq=False)
class LaserScan:
    """One scan as it was measured, and those of the robot's other lasers."""

    ranges: NDArray[np.floating]
    """(n,) [m]; not finite, not positive, `range_max_m` or longer: no return."""
    range_max_m: float
    angle_min: float
    """Direction of the first beam in the laser's frame [rad]."""
    angle_step: float
    """From one beam to the next [rad]."""
    robot_from_laser: Pose
    others: tuple[Self, ...] = ()
    """Of other lasers, as at the same pose; they have no others."""

    def chosen(self, choose: "Callable[[LaserScan, int], Beams]", max_beams: int) -> Beams:
        """The beams that are scored, of each laser as many.

        Args:
            choose: at most so many of one laser's.
            max_beams: of all lasers together.
        """
        if not self.others:
            return choose(self, max_beams)
        share = max(max_beams // (1 + len(self.others)), 1)
        others = tuple(choose(other, share) for other in self.others)
        return replace(choose(self, share), others=others)

    def beams(
        self, ranges: NDArray[np.float64], chosen: NDArray[np.int64], max_range_m: float
    ) -> Beams:
        """The chosen ones of (n,) ranges, which may be cut off at `max_range_m`."""
        angles = np.asarray(self.angle_min + self.angle_step * chosen, np.float64)
        return Beams(ranges[chosen], angles, self.robot_from_laser, max_range_m)


class SensorModel(Hashable, Protocol):
    """Weighs poses in one map by scans."""

    beam_work: ClassVar[int]
    """Cost of a beam of a pose, in look-ups of a table."""

    @property
    def grid(self) -> Grid:
        """The map."""

    @property
    def settings(self) -> SensorSettings:
        """The model's numbers."""

    @property
    def pyramid(self) -> Pyramid:
        """The map's likelihood field over squares: tells searches where to look."""

    @property
    def jumps(self) -> JumpField:
        """How far rays may jump in the map."""

    @classmethod
    def arrays_of(cls, grid: Grid, settings: SensorSettings) -> MapArrays:
        """Compute what the model needs of a map; it takes seconds, and may be kept on disk.

        Raises:
            ValueError: no cell is occupied; every pose would fit equally well.
        """

    @classmethod
    def from_arrays(cls, grid: Grid, arrays: MapArrays, settings: SensorSettings) -> Self:
        """The model, from what `arrays_of` computed of the same map with the same settings.

        Raises:
            KeyError, ValueError: an array is missing, or is of another map.
        """

    def beams(self, scan: LaserScan) -> Beams:
        """Choose the beams that are scored: unusable ones are dropped, then the rest thinned."""

    def log_likelihood(self, map_from_robot: Poses, beams: Beams) -> LogWeights:
        """(N,) log p(z | x), a sum over beams, without the exponent."""

    def correction(
        self, map_from_robot: Poses, weights: NDArray[np.float64], beams: Beams, sharers: int = 1
    ) -> float:
        """What is taken back from a cluster's log evidence, with the exponent.

        For what `log_likelihood` cannot see at a price that is right for every particle.

        Args:
            map_from_robot: (N, 3) the cluster's poses after the scan.
            weights: (N,) their weights, summing to one.
            beams: those the poses were weighed by.
            sharers: so many ask of the same cluster, with particles of their own, as the shards
                of a search; each does its part of the work.
        """
