"""The commands that `ClusterMCL` and `Client` share: `set_pose` and `relocalize`."""

from __future__ import annotations  # `help` shows names of types, not their definitions

import uuid

import numpy as np
from numpy.typing import ArrayLike

from clustermcl.protocol.answers import Relocalize, SetPose
from clustermcl.protocol.codec import refusal_of
from clustermcl.protocol.message import MAX_POSE_M, Circle
from clustermcl.protocol.pose_arrays import checked_pose, covariance_tuple
from clustermcl.runtime.caller import caller


class RobotCommands:
    """Checks `set_pose` and `relocalize`; a subclass implements `_carry_out`."""

    def set_pose(
        self,
        pose: ArrayLike,
        *,
        position_sigma_m: float = 0.5,
        heading_sigma_rad: float = 0.26,
        covariance: ArrayLike | None = None,
        stamp_ns: int | None = None,
        floor: str = "",
    ) -> None:
        """Replace the belief by a pose, whose probability is `belief.set_pose_probability`.

        The state is `searching` until the next scan, which decides whether the pose holds. Before
        the first scan and the map have arrived, the pose is stored and set later.

        Args:
            pose: (3,) pose in the map: x [m], y [m], heading [rad].
            position_sigma_m: standard deviation of x and of y.
            heading_sigma_rad: standard deviation of the heading.
            covariance: (3, 3) covariance of x, y, heading [m², m rad, rad²], or its nine numbers
                row by row; replaces both standard deviations.
            stamp_ns: time of the pose by the robot's clock [ns]; the motion since then is added.
                None: now.
            floor: the floor of the pose; a building of several floors needs it.

        Raises:
            CommandRefusedError: the map has no free space within three standard deviations or no
                such floor, or odometry of that time is no longer stored.
            ValueError: a number is not finite, the heading is beyond a full turn, a standard
                deviation is not positive, or the covariance is not positive semi-definite.
        """
        numbers = None if covariance is None else np.asarray(covariance, np.float64)
        if numbers is not None and numbers.size != 9:
            raise ValueError(f"covariance has shape {numbers.shape}, expected (3, 3)")
        command = SetPose(
            sender=caller(),
            command_id=new_id(),
            pose=checked_pose("pose", pose),
            position_sigma_m=position_sigma_m,
            heading_sigma_rad=heading_sigma_rad,
            covariance=None if numbers is None else covariance_tuple(numbers),
            stamp_ns=stamp_ns,
            floor=floor,
        )
        self._check_and_carry_out(command)

    def relocalize(self, near: Circle | None = None, floor: str = "") -> None:
        """Drop all places, including the last pose in the state file, and search for places.

        Args:
            near: x, y and radius of a circle to search in [m]; None: search everywhere.
            floor: the floor of `near`, or to search without it; empty: all floors.

        Raises:
            CommandRefusedError: there is no floor of this name.
            ValueError: a number of `near` is not finite, or the radius is not positive.
        """
        if near is not None:
            x, y, radius_m = map(float, near) if np.size(near) == 3 else (np.nan,) * 3
            if not (abs(x) < MAX_POSE_M > abs(y) and 0.0 < radius_m < np.inf):
                raise ValueError(f"near is x, y and a radius above 0, all finite, not {near}")
            near = (x, y, radius_m)
        self._check_and_carry_out(
            Relocalize(sender=caller(), command_id=new_id(), near=near, floor=floor)
        )

    def _check_and_carry_out(self, command: SetPose | Relocalize) -> None:
        if problem := refusal_of(command):
            raise ValueError(f"the command is invalid: {problem}")
        self._carry_out(command)

    def _carry_out(self, command: SetPose | Relocalize) -> None:
        pass


def new_id() -> str:
    """Return a unique id for a command, by which its repetitions are recognised."""
    return uuid.uuid4().hex
