"""Symmetric places: the images of a pose, and whether a scan distinguishes them."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.laser.ray_casting import cast_rays_from_poses, jump_field
from clustermcl.filter.poses import compose, wrap_angle
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan
from clustermcl.recordings.maps.grid_map import GridMap

DISTINGUISHING_BEAMS = 3
"""Two places are distinguished by at least this number of beams with different ranges."""
DISTINGUISHING_M = 0.3
"""Least difference [m]: ten times the range noise, and more than a grazing ray's error."""


def turned_copies(
    pose: PoseTuple, times: int, middle: tuple[float, float]
) -> tuple[PoseTuple, ...]:
    """A pose and its images after turns of the whole map by 1 / `times` of a full turn.

    Args:
        pose: the true one; it comes first.
        times: of the symmetry; 1: there is nothing but the pose itself.
        middle: about which the map is turned.
    """
    x, y, heading = pose[0] - middle[0], pose[1] - middle[1], pose[2]
    copies = [pose]
    for turn in range(1, times):
        angle = math.tau * turn / times
        c, s = math.cos(angle), math.sin(angle)
        copies.append(
            (middle[0] + c * x - s * y, middle[1] + s * x + c * y, wrap_angle(heading + angle))
        )
    return tuple(copies)


def middle_of(grid_map: GridMap) -> tuple[float, float]:
    """Return the middle of the grid in the map frame [m]."""
    width_m, height_m = grid_map.size_m
    middle = np.array([width_m / 2, height_m / 2, 0.0])
    x, y, _ = compose(np.array(grid_map.map_from_grid), middle)
    return float(x), float(y)


class ScanObservability:
    """Compares expected ranges in a map.

    Args:
        grid_map: the map.
    """

    def __init__(self, grid_map: GridMap) -> None:
        self._jumps, self._grid = jump_field(grid_map.cells), grid_map.grid

    def expected(self, scan: Scan, poses: Sequence[PoseTuple]) -> NDArray[np.float64]:
        """Return the (N, B) expected ranges of the scan's beams at N poses [m]."""
        beams = scan.ranges.shape[0]
        angles = scan.angle_min_rad + scan.angle_step_rad * np.arange(beams, dtype=np.float64)
        lasers = compose(np.array(poses), np.array(scan.robot_from_laser))
        return cast_rays_from_poses(self._jumps, self._grid, lasers, angles, scan.range_max_m)

    def distinguishes(self, scan: Scan, places: Sequence[PoseTuple]) -> bool:
        """Return whether a scan at the first place would look different from all other places.

        At least `DISTINGUISHING_BEAMS` expected ranges must differ by `DISTINGUISHING_M`; beams
        without a return are ignored. Measured ranges, so noise and people, do not matter.

        Raises:
            ValueError: there is only one place.
        """
        if len(places) < 2:
            raise ValueError("there is no other place to tell the first one from")
        ranges = self.expected(scan, places)[:, _returned(scan)]
        differs = np.abs(ranges[1:] - ranges[0]) > DISTINGUISHING_M
        return bool(np.all(np.count_nonzero(differs, axis=1) >= DISTINGUISHING_BEAMS))

    def short_share(self, scan: Scan, map_from_robot: PoseTuple) -> float:
        """Return the share of beams that end 0.3 m or more before the map's obstacle."""
        expected = self.expected(scan, [map_from_robot])[0]
        short = _returned(scan) & (scan.ranges.array() < expected - DISTINGUISHING_M)
        return float(np.mean(short))


def _returned(scan: Scan) -> NDArray[np.bool_]:
    ranges = scan.ranges.array()
    return np.asarray(np.isfinite(ranges) & (ranges > 0.0) & (ranges < scan.range_max_m))
