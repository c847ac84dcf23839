"""The commands that change a belief, for the library and for a running system."""

import math
import uuid

from protocol.answers import Relocalize, SetPose
from protocol.codec import refusal_of
from protocol.message import Circle, Covariance, PoseTuple


class RobotCommands:
    """Base class with `set_pose` and `relocalize`; a subclass carries the commands out."""

    def set_pose(
        self,
        map_from_robot: PoseTuple,
        *,
        position_sigma_m: float = 0.5,
        heading_sigma_rad: float = 0.26,
        covariance: Covariance | None = None,
        stamp_ns: int | None = None,
    ) -> None:
        """Give the robot's pose; its probability becomes `belief.set_pose_probability`.

        The state is `searching` until a scan confirms the pose. A pose that is given before the map
        or the first scan arrives is applied then.

        Args:
            map_from_robot: x [m], y [m], heading [rad].
            position_sigma_m: standard deviation of x and of y.
            heading_sigma_rad: standard deviation of the heading.
            covariance: 3 x 3, row by row, over x, y, heading [m², m rad, rad²]; replaces both
                sigmas.
            stamp_ns: time of the pose by the robot's clock [ns]; odometry since then is added.
                None: now.

        Raises:
            CommandRefusedError: the map has no free space within 3 sigma, or odometry of that
                time is no longer kept.
            ValueError: a number is not finite, a sigma is not positive, or the covariance is not
                positive semi-definite.
        """
        command = SetPose(
            sender="client",
            command_id=new_id(),
            map_from_robot=map_from_robot,
            position_sigma_m=position_sigma_m,
            heading_sigma_rad=heading_sigma_rad,
            covariance=covariance,
            stamp_ns=stamp_ns,
        )
        if problem := refusal_of(command):
            raise ValueError(f"pose {map_from_robot} is invalid: {problem}")
        self._carry_out(command)

    def relocalize(self, near: Circle | None = None, region: str = "") -> None:
        """Drop all places, including the stored last pose, and search.

        Args:
            near: x, y and radius of the circle to search [m]; None: everywhere.
            region: name of the region of `search.regions` to search; empty: everywhere.

        Raises:
            CommandRefusedError: there is no such region.
            ValueError: `near` is not a circle.
        """
        if near is not None and not (all(map(math.isfinite, near)) and near[2] > 0.0):
            raise ValueError(f"a circle is two finite numbers and a positive radius: {near}")
        self._carry_out(Relocalize(sender="client", command_id=new_id(), near=near, region=region))

    def _carry_out(self, command: SetPose | Relocalize) -> None:
        raise NotImplementedError


def new_id() -> str:
    """Return a unique id, by which a repeated command is recognised."""
    return uuid.uuid4().hex
