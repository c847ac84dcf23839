"""The free ground of a map on a coarse grid, which shows where a robot can be."""

import math

import msgspec
import numpy as np

from clustermcl.filter.arrays import FREE
from clustermcl.filter.poses import between
from clustermcl.protocol.floors import ONE_MAP, Floors
from clustermcl.protocol.message import Covariance, PoseTuple
from clustermcl.protocol.pose_arrays import covariance_matrix
from clustermcl.recordings.maps.grid_map import GridMap

LEAF_M = 0.2
MAX_LEAVES = 1_000_000
"""Largest number of leaves, which need 125 kB; a larger map has larger leaves."""
REACH_SIGMAS = 3.0
"""A given pose may be this many standard deviations off."""


class FreeGround(msgspec.Struct, frozen=True, kw_only=True):
    """The squares (leaves) of a map that contain a free cell."""

    map_digest: str
    leaf_m: float
    map_from_grid: PoseTuple
    rows: int
    cols: int
    bits: bytes
    """(rows x cols) one bit for each leaf; row 0 has the lowest y."""
    floors: Floors = ONE_MAP

    def __post_init__(self) -> None:
        if len(self.bits) != -(-self.rows * self.cols // 8):
            raise ValueError(f"{len(self.bits)} bytes do not fill {self.rows} x {self.cols} leaves")

    @classmethod
    def of(cls, grid_map: GridMap) -> "FreeGround":
        cells, side = grid_map.cells, LEAF_M / grid_map.cell_m
        leaf = max(round(side), math.ceil(math.sqrt(cells.size / MAX_LEAVES)), 1)
        first = range(0, cells.shape[1], leaf)
        free = np.array(
            [
                np.logical_or.reduceat((cells[row : row + leaf] == FREE).any(axis=0), first)
                for row in range(0, cells.shape[0], leaf)
            ]
        )
        return cls(
            map_digest=grid_map.digest,
            leaf_m=leaf * grid_map.cell_m,
            map_from_grid=grid_map.map_from_grid,
            rows=free.shape[0],
            cols=free.shape[1],
            bits=np.packbits(free).tobytes(),
            floors=grid_map.floors,
        )

    def problem_of(
        self, map_from_robot: PoseTuple, covariance: Covariance, floor: str = ""
    ) -> str | None:
        """Return why a robot cannot be at a pose; None if free ground is within its uncertainty.

        Args:
            map_from_robot: x [m], y [m], heading [rad].
            covariance: covariance of the pose, 3 x 3 row by row [m^2, m rad, rad^2].
            floor: the floor of the pose; empty for a single map.
        """
        try:
            in_atlas = self.floors.in_atlas(floor, map_from_robot)
        except ValueError as error:
            return str(error)
        bits = np.unpackbits(np.frombuffer(self.bits, np.uint8), count=self.rows * self.cols)
        free = bits.reshape(self.rows, self.cols)
        x, y, _ = between(np.array(self.map_from_grid), np.array(in_atlas)).tolist()
        # The robot may be anywhere in a leaf, so the variance of its side is added.
        spread = covariance_matrix(covariance)[:2, :2] + np.eye(2) * self.leaf_m**2 / 12
        variance = float(np.linalg.eigvalsh(spread)[-1])
        reach_m = REACH_SIGMAS * math.sqrt(variance)
        rows, cols = self._near(y, reach_m), self._near(x, reach_m)
        near = np.argwhere(free[rows, cols]) + np.array([rows.start + 0.5, cols.start + 0.5])
        off_in_grid = near[:, ::-1] * self.leaf_m - (x, y)
        c, s = math.cos(self.map_from_grid[2]), math.sin(self.map_from_grid[2])
        off = off_in_grid @ np.array([[c, s], [-s, c]])
        is_here = self.floors.on_floor(in_atlas)[0] == floor  # the next is 40 m beside it
        if is_here and np.any(np.sum(off @ np.linalg.inv(spread) * off, axis=1) <= REACH_SIGMAS**2):
            return None
        x, y, _ = map_from_robot
        sigma_m = math.sqrt(max(variance - self.leaf_m**2 / 12, 0.0))
        return (
            f"the map has no free ground within {REACH_SIGMAS:g} sigma ({sigma_m:.2f} m each) "
            f"of x {x:.2f} m, y {y:.2f} m; give a pose on free ground, or a larger uncertainty"
        )

    def _near(self, at_m: float, reach_m: float) -> slice:
        """Return the rows or columns of leaves within reach; negative ones are cut off."""
        first, last = (at_m - reach_m) / self.leaf_m, (at_m + reach_m) / self.leaf_m
        return slice(max(math.floor(first), 0), max(math.ceil(last), 0))
