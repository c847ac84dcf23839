"""Memory of the robot's earlier views, which measures how new the view of a scan is.

Errors of the map are the same whenever the robot returns to a place, so a scan from there
repeats earlier evidence, however old. The memory holds a limited number of weighted views, whose
poses become uncertain as odometry errs.
"""

import msgspec
import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Pose, Poses
from clustermcl.filter.motion.noise import motion_covariance
from clustermcl.filter.poses import compose, heading_distance, inverse
from clustermcl.filter.settings import BeliefSettings, MotionSettings

MAX_VIEWS = 256
"""Maximum number of views; the least important are removed first, of equal ones the oldest."""
JOINED = 0.2
"""Distance below which two views become one; at 1, errors of the map correlate by 1/e."""
FADED = 0.02
"""A view is forgotten if a scan from the same pose would repeat less than this share of it."""
COLUMNS = 6
MOST = 1e6
"""Largest number in the memory; views farther away [m] are forgotten."""


class ViewMemory(msgspec.Struct, frozen=True):
    """Weighted earlier views of one robot, relative to its present pose."""

    views: bytes = b""
    """(V, 6) little-endian float32: x [m], y [m] and heading [rad] of a view, seen from where the
    robot is now; its weight; and the variances of that position [m^2] and that heading [rad^2]."""

    @classmethod
    def of_this_scan(cls) -> "ViewMemory":
        """Return the memory of a robot whose only view is that of the present scan."""
        return cls(np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0], "<f4").tobytes())

    @property
    def problem(self) -> str | None:
        """Why `views` is invalid; None: it is valid."""
        count, rest = divmod(len(self.views), 4 * COLUMNS)
        if rest or count > MAX_VIEWS:
            return f"{len(self.views)} bytes of views"
        rows = np.frombuffer(self.views, "<f4").reshape(-1, COLUMNS)
        possible = (rows <= MOST) & (rows >= (-MOST, -MOST, -MOST, 0.0, 0.0, 0.0))
        return None if possible.all() else "views out of range"

    @property
    def rows(self) -> NDArray[np.float64]:
        """The (V, 6) numbers of `views`; a copy."""
        return np.frombuffer(self.views, "<f4").reshape(-1, COLUMNS).astype(np.float64)

    def after(
        self, before_from_after: Pose, motion: MotionSettings, rules: BeliefSettings
    ) -> tuple[float, "ViewMemory"]:
        """Return the weight of the next scan, and the memory with it.

        The errors of earlier scans, with weights w_s, correlate with those of this scan by k_s. So
        this scan repeats sum(w_s k_s), and the rest is its weight. On a straight drive the weight
        is 1 - k, with the k of the scan before.

        Args:
            before_from_after: (3,) the motion since the scan before, by odometry.
            motion: noise of the odometry.
            rules: contain the distance and turn over which views correlate.

        Returns:
            The weight of the scan, 0 to 1, and the memory with it.
        """
        if rules.view_distance_m == 0.0:
            return 1.0, self
        rows = self._moved(before_from_after, motion)
        metres, radians = rules.view_distance_m, rules.view_turn_rad
        apart, turned = np.sqrt(rows[:, 0] ** 2 + rows[:, 1] ** 2), np.abs(rows[:, 2])
        # A correlation exp(-d) that is blurred by a Gaussian is wider and lower: its variance
        # grows by that of the Gaussian, and its integral stays.
        wide_m = np.sqrt(metres**2 + rows[:, 4] / 6.0)
        wide_rad = np.sqrt(radians**2 + rows[:, 5] / 2.0)
        own = rows[:, 3] * (metres / wide_m) ** 2 * (radians / wide_rad)
        repeated = float(np.add.reduce(own * np.exp(-apart / wide_m - turned / wide_rad)))
        weight = max(1.0 - repeated, 0.0)
        near = apart / metres + turned / radians
        if len(rows) and near.min() < JOINED:
            joined = int(near.argmin())
            total = rows[joined, 3] + weight
            rows[joined, 4:] *= rows[joined, 3] / total
            rows[joined, 3] = total
            own[joined] += weight
        elif weight > FADED:
            rows = np.concatenate([rows, [[0.0, 0.0, 0.0, weight, 0.0, 0.0]]])
            own = np.append(own, weight)
        kept = (own > FADED) & (np.abs(rows) < MOST).all(axis=1)
        if np.count_nonzero(kept) > MAX_VIEWS:
            kept[np.argsort(np.where(kept, own, 0.0), kind="stable")[:-MAX_VIEWS]] = False
        return weight, ViewMemory(rows[kept].astype("<f4").tobytes())

    def new_share(self, poses: Poses, rules: BeliefSettings) -> NDArray[np.float64]:
        """Return the (N,) new shares of views from (N, 3) poses relative to the robot.

        Only the views in memory count, not the other poses.
        """
        rows = self.rows
        if rules.view_distance_m == 0.0 or not len(rows):
            return np.ones(len(poses))
        wide_m = np.sqrt(rules.view_distance_m**2 + rows[:, 4] / 6.0)
        wide_rad = np.sqrt(rules.view_turn_rad**2 + rows[:, 5] / 2.0)
        own = rows[:, 3] * (rules.view_distance_m / wide_m) ** 2 * (rules.view_turn_rad / wide_rad)
        off = poses[:, None] - rows[None, :, :3]
        apart, turned = np.hypot(off[..., 0], off[..., 1]), heading_distance(off[..., 2], 0.0)
        repeated = (own * np.exp(-apart / wide_m - turned / wide_rad)).sum(axis=1)
        return np.asarray(np.maximum(1.0 - repeated, 0.0))

    def _moved(self, before_from_after: Pose, motion: MotionSettings) -> NDArray[np.float64]:
        """Return (V, 6) views relative to the new pose, with the variance of this motion added."""
        rows = self.rows
        noise = motion_covariance(before_from_after, motion)
        rows[:, :3] = compose(inverse(before_from_after), rows[:, :3])
        # An error of the turn displaces a view in proportion to its distance.
        far = rows[:, 0] ** 2 + rows[:, 1] ** 2
        rows[:, 4] += noise[0, 0] + noise[1, 1] + far * noise[2, 2]
        rows[:, 5] += noise[2, 2]
        return rows
