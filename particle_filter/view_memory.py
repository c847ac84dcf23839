"""How new a view of the building a scan is, counting all that was seen before near its pose.

Errors of the map are the same whenever the robot comes back, so a scan from where it has looked
before repeats what was said, however long ago that was and in whatever order. The memory is a
coarse grid of weighted views; it has a fixed size, and blurs as odometry errs.
"""

import msgspec
import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import Pose
from particle_filter.motion_noise import motion_covariance
from particle_filter.poses import compose, inverse
from particle_filter.settings import BeliefSettings, MotionSettings

MAX_VIEWS = 256
"""Views kept; those that hide least go first, of equal ones the oldest."""
JOINED = 0.2
"""Views this near each other are kept as one; errors of the map correlate by 1/e at 1."""
FADED = 0.02
"""A view that hides less than this of the same view is forgotten."""
COLUMNS = 6
MOST = 1e6
"""Of any number kept; what is farther away is forgotten."""


class ViewMemory(msgspec.Struct, frozen=True):
    """What a robot has seen."""

    views: bytes = b""
    """(V, 6) little-endian float32: x [m], y [m] and heading [rad] of a view, seen from where the
    robot is now; its weight; and the variances of that position [m^2] and that heading [rad^2]."""

    @classmethod
    def of_this_scan(cls) -> "ViewMemory":
        """A robot that has seen what it sees now, and nothing else."""
        return cls(np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0], "<f4").tobytes())

    @property
    def problem(self) -> str | None:
        """Why no robot can have seen this; None where one can."""
        count, rest = divmod(len(self.views), 4 * COLUMNS)
        if rest or count > MAX_VIEWS:
            return f"{len(self.views)} bytes of views"
        rows = np.frombuffer(self.views, "<f4").reshape(-1, COLUMNS)
        possible = (np.abs(rows) <= MOST) & (rows >= (-MOST, -MOST, -MOST, 0.0, 0.0, 0.0))
        return None if possible.all() else "views that nobody can have had"

    def after(
        self, before_from_after: Pose, motion: MotionSettings, rules: BeliefSettings
    ) -> tuple[float, "ViewMemory"]:
        """Take a scan.

        Of earlier scans with weights w_s, whose errors correlate with this one's by k_s, it
        repeats sum(w_s k_s); the rest is its own weight. On a straight drive that is 1 - k of the
        scan before: the share of an exponentially correlated error that is new.

        Args:
            before_from_after: (3,) the motion since the scan before, by odometry.
            motion: how far odometry errs.
            rules: how far views are alike.

        Returns:
            The weight of the scan, 0 to 1, and the memory with it.
        """
        if rules.view_distance_m == 0.0:
            return 1.0, self
        rows = self._moved(before_from_after, motion)
        metres, radians = rules.view_distance_m, rules.view_turn_rad
        apart, turned = np.sqrt(rows[:, 0] ** 2 + rows[:, 1] ** 2), np.abs(rows[:, 2])
        # A correlation exp(-d) that is blurred by a Gaussian falls off over more, from less: its
        # variance grows by that of the Gaussian, and its integral stays.
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

    def _moved(self, before_from_after: Pose, motion: MotionSettings) -> NDArray[np.float64]:
        """(V, 6) the views from where the robot is now, less certain by this motion's error."""
        rows = np.frombuffer(self.views, "<f4").reshape(-1, COLUMNS).astype(np.float64)
        noise = motion_covariance(before_from_after, motion)
        rows[:, :3] = compose(inverse(before_from_after), rows[:, :3])
        # An error of the turn swings what is far away by as much as it is far.
        far = rows[:, 0] ** 2 + rows[:, 1] ** 2
        rows[:, 4] += noise[0, 0] + noise[1, 1] + far * noise[2, 2]
        rows[:, 5] += noise[2, 2]
        return rows
