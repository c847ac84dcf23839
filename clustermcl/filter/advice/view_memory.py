"""Memory of the robot's earlier views, so that advice sends it where it has not looked from."""

import msgspec
import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Pose, Poses
from clustermcl.filter.laser.evidence_model import VIEW_M, VIEW_RAD
from clustermcl.filter.poses import compose, heading_distance, inverse

MAX_VIEWS = 256
"""Maximum number of views. The newest are kept, as odometry forgets where the others were."""
LEAST_NEW = 0.02
"""A scan of which a smaller share is new adds no view."""
COLUMNS = 4
MOST = 1e6
"""Largest number in the memory; views farther away [m] are forgotten."""


class ViewMemory(msgspec.Struct, frozen=True):
    """Weighted earlier views of one robot, relative to its present pose."""

    views: bytes = b""
    """(V, 4) little-endian float32: x [m], y [m] and heading [rad] of a view, seen from where the
    robot is now, and its weight: the share of it that was new."""

    @classmethod
    def of_this_scan(cls) -> "ViewMemory":
        """Return the memory of a robot whose only view is that of the present scan."""
        return cls(np.array([0.0, 0.0, 0.0, 1.0], "<f4").tobytes())

    @property
    def problem(self) -> str | None:
        """Why `views` is invalid; None: it is valid."""
        count, rest = divmod(len(self.views), 4 * COLUMNS)
        if rest or count > MAX_VIEWS:
            return f"{len(self.views)} bytes of views"
        rows = self.rows
        possible = (np.abs(rows) <= MOST) & (rows >= (-MOST, -MOST, -MOST, 0.0))
        return None if possible.all() else "views out of range"

    @property
    def rows(self) -> NDArray[np.float64]:
        """The (V, 4) numbers of `views`; a copy."""
        return np.frombuffer(self.views, "<f4").reshape(-1, COLUMNS).astype(np.float64)

    def after(self, before_from_after: Pose) -> "ViewMemory":
        """Return the memory with the next scan, after a motion (3,) by odometry."""
        rows = self.rows
        rows[:, :3] = compose(inverse(before_from_after), rows[:, :3])
        here = np.zeros((1, 3))
        new = _new_share(here, rows)
        if new[0] > LEAST_NEW:
            rows = np.concatenate([rows, np.column_stack([here, new])])
        kept = rows[(np.abs(rows) < MOST).all(axis=1)][-MAX_VIEWS:]
        return ViewMemory(kept.astype("<f4").tobytes())

    def new_share(self, poses: Poses) -> NDArray[np.float64]:
        """Return the (N,) new shares of views from (N, 3) poses relative to the robot.

        Errors of earlier scans, with weights w_s, correlate with those of a scan by k_s. So it
        repeats sum(w_s k_s), and the rest is new. Only views in memory count, not other poses.
        """
        return _new_share(poses, self.rows)


def _new_share(poses: Poses, rows: NDArray[np.float64]) -> NDArray[np.float64]:
    off = poses[:, None] - rows[None, :, :3]
    apart, turned = np.hypot(off[..., 0], off[..., 1]), heading_distance(off[..., 2], 0.0)
    repeated = (rows[:, 3] * np.exp(-apart / VIEW_M - turned / VIEW_RAD)).sum(axis=1)
    return np.asarray(np.maximum(1.0 - repeated, 0.0))
