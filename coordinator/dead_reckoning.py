"""How the robot moved by odometry since a step, and how uncertain that is."""

import math

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import Pose
from particle_filter.motion_noise import composed_covariance, motion_covariance
from particle_filter.poses import between, compose, wrap_angle
from particle_filter.settings import MotionSettings
from process_runtime.settings import BridgeSettings
from protocol.message import Covariance, PoseTuple
from protocol.pose_arrays import covariance_matrix, covariance_tuple, pose_tuple

NO_NOISE: Covariance = (0.0,) * 9
LEAST_GATE_M, LEAST_GATE_RAD = 0.05, 0.05
"""A bridge whose gate is always open makes a step of each scan; here a gate has a size."""


def gates_between(before: PoseTuple, after: PoseTuple, bridge: BridgeSettings) -> float:
    """How many times the motion from one odometry pose to another opens the bridge's gate."""
    driven_m = math.dist(before[:2], after[:2])
    turned_rad = abs(wrap_angle(after[2] - before[2]))
    return max(
        driven_m / max(bridge.gate_distance_m, LEAST_GATE_M),
        turned_rad / max(bridge.gate_turn_rad, LEAST_GATE_RAD),
    )


def carried(
    mean: PoseTuple,
    covariance: Covariance,
    then: PoseTuple,
    now: PoseTuple,
    motion: MotionSettings | None,
) -> tuple[PoseTuple, Covariance]:
    """A place as it is now, by odometry alone.

    Args:
        mean: in the map, then.
        covariance: of it.
        then: odometry when it held.
        now: odometry now.
        motion: how far odometry errs; None: not at all.
    """
    if then == now:
        return mean, covariance
    place, moved = np.array(mean), between(np.array(then), np.array(now))
    noise = np.zeros((3, 3)) if motion is None else motion_covariance(moved, motion)
    grown = composed_covariance(place, covariance_matrix(covariance), moved, noise)
    return pose_tuple(compose(place, moved)), covariance_tuple(grown)


class DeadReckoning:
    """Adds up the odometry since a step, in pieces as long as a step is.

    So the uncertainty is what the particles would have come to without a scan to weigh them: they
    get their noise once a step, and independently.

    Args:
        motion: how far odometry errs.
        bridge: its gate is what makes a step.
    """

    def __init__(self, motion: MotionSettings, bridge: BridgeSettings) -> None:
        self._motion, self._bridge = motion, bridge
        self._covariance: Covariance = NO_NOISE
        """Of `_piece` in the frame of the step."""
        self._step: PoseTuple = (0.0, 0.0, 0.0)
        self._piece = self._now = self._step

    def use(self, motion: MotionSettings, bridge: BridgeSettings) -> None:
        """Go on with other numbers."""
        self._motion, self._bridge = motion, bridge

    def begin_at(self, odom_from_robot: PoseTuple) -> None:
        """A step was taken there; what odometry said since is counted on as one piece."""
        self._covariance = NO_NOISE
        self._step = self._piece = odom_from_robot

    def on_odometry(self, odom_from_robot: PoseTuple) -> None:
        """The robot is there now."""
        self._now = odom_from_robot
        if gates_between(self._piece, self._now, self._bridge) >= 1.0:
            self._covariance = covariance_tuple(self.motion()[1])
            self._piece = self._now

    def motion(self) -> tuple[Pose, NDArray[np.float64]]:
        """(3,) how the robot moved since the step, in its frame then, and (3, 3) covariance."""
        step, piece, now = np.array(self._step), np.array(self._piece), np.array(self._now)
        last = between(piece, now)
        if self._piece == self._step:  # most often: nothing to compose
            return last, motion_covariance(last, self._motion)
        before, noise = covariance_matrix(self._covariance), motion_covariance(last, self._motion)
        covariance = composed_covariance(between(step, piece), before, last, noise)
        return between(step, now), covariance


class DrivenGates:
    """How far the robot has driven since the last scan that counted, in the bridge's gates.

    Args:
        bridge: has the gate.
    """

    def __init__(self, bridge: BridgeSettings) -> None:
        self.bridge = bridge
        self._counted: PoseTuple | None = None
        self.gates = 0.0

    def begin_at(self, odom_from_robot: PoseTuple) -> None:
        """A scan that was taken there counted."""
        self._counted, self.gates = odom_from_robot, 0.0

    def on_odometry(self, odom_from_robot: PoseTuple) -> None:
        """The robot is there now; less than a gate is not counted, or it would be noise."""
        self._counted = self._counted or odom_from_robot
        gates = gates_between(self._counted, odom_from_robot, self.bridge)
        if gates >= 1.0:
            self._counted = odom_from_robot
            self.gates += gates
