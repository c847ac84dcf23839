"""What a scan can show: whether it tells symmetric places apart, and how much was in its way."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from grid_maps.grid_map import GridMap
from particle_filter.poses import compose, inverse
from particle_filter.ray_casting import cast_rays_from_poses, jump_field
from protocol.message import PoseTuple
from protocol.steps import Scan

DISTINGUISHING_BEAMS = 3
"""So many beams that would be of another length tell two places apart."""
DISTINGUISHING_M = 0.3
"""By so much: ten times the noise of a range, and more than a grazing ray's doubt."""


class ScanObservability:
    """Ranges as the map has them.

    Args:
        grid_map: the map.
    """

    def __init__(self, grid_map: GridMap) -> None:
        self._jumps, self._cell_m = jump_field(grid_map.cells), grid_map.cell_m
        self._grid_from_map = inverse(np.array(grid_map.map_from_grid))

    def expected(self, scan: Scan, poses: Sequence[PoseTuple]) -> NDArray[np.float64]:
        """(N, B) ranges [m] that the scan's beams would have at each of N poses of the robot."""
        beams = scan.ranges.shape[0]
        angles = scan.angle_min_rad + scan.angle_step_rad * np.arange(beams, dtype=np.float64)
        grid_from_laser = compose(
            compose(self._grid_from_map, np.array(poses)), np.array(scan.robot_from_laser)
        )
        return cast_rays_from_poses(
            self._jumps, self._cell_m, grid_from_laser, angles, scan.range_max_m
        )

    def distinguishes(self, scan: Scan, places: Sequence[PoseTuple]) -> bool:
        """Whether a scan taken at the first place looks different from each of the others.

        Different is what 3 beams or more show that by the map differ by over 0.3 m; beams that
        did not return show nothing. What the scan itself measured does not matter: the
        definition is about what there was to see, not about noise or people.

        Raises:
            ValueError: there is only one place.
        """
        if len(places) < 2:
            raise ValueError("there is no other place to tell the first one from")
        ranges = self.expected(scan, places)[:, _returned(scan)]
        differs = np.abs(ranges[1:] - ranges[0]) > DISTINGUISHING_M
        return bool(np.all(np.count_nonzero(differs, axis=1) >= DISTINGUISHING_BEAMS))

    def short_share(self, scan: Scan, map_from_robot: PoseTuple) -> float:
        """Share of the beams that return from 0.3 m or more in front of what the map has there."""
        expected = self.expected(scan, [map_from_robot])[0]
        short = _returned(scan) & (scan.ranges.array() < expected - DISTINGUISHING_M)
        return float(np.mean(short))


def _returned(scan: Scan) -> NDArray[np.bool_]:
    ranges = scan.ranges.array()
    return np.asarray(np.isfinite(ranges) & (ranges > 0.0) & (ranges < scan.range_max_m))
