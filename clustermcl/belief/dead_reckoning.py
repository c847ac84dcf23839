"""The robot's motion since a step by odometry, with its uncertainty."""

import math

import numpy as np
from numpy.typing import NDArray

from clustermcl.belief.part import Part
from clustermcl.filter.arrays import Pose
from clustermcl.filter.motion.noise import composed_covariance, motion_covariance
from clustermcl.filter.poses import between, compose, wrap_angle
from clustermcl.filter.settings import MotionSettings
from clustermcl.protocol.message import Covariance, PoseTuple
from clustermcl.protocol.pose_arrays import covariance_matrix, covariance_tuple, pose_tuple
from clustermcl.runtime.settings import BridgeSettings

NO_NOISE: Covariance = (0.0,) * 9
ORIGIN: PoseTuple = (0.0, 0.0, 0.0)
LEAST_GATE = 0.05
"""Smallest gate: a bridge with a gate of 0 makes a step of each scan [m] and [rad]."""


def gates_between(before: PoseTuple, after: PoseTuple, bridge: BridgeSettings) -> float:
    """Return the motion between two odometry poses in multiples of the bridge's gate."""
    driven_m = math.dist(before[:2], after[:2])
    turned_rad = abs(wrap_angle(after[2] - before[2]))
    return max(
        driven_m / max(bridge.gate_distance_m, LEAST_GATE),
        turned_rad / max(bridge.gate_turn_rad, LEAST_GATE),
    )


def moved_by(
    mean: PoseTuple, covariance: Covariance, motion: Pose, noise: NDArray[np.float64]
) -> tuple[PoseTuple, Covariance]:
    """Return a pose and its covariance after a (3,) motion with a (3, 3) covariance."""
    place = np.array(mean)
    grown = composed_covariance(place, covariance_matrix(covariance), motion, noise)
    return pose_tuple(compose(place, motion)), covariance_tuple(grown)


def carried(
    mean: PoseTuple,
    covariance: Covariance,
    then: PoseTuple,
    now: PoseTuple,
    motion: MotionSettings | None,
) -> tuple[PoseTuple, Covariance]:
    """Return a pose and its covariance after the robot has moved by odometry from `then` to `now`.

    Without `motion`, its settings, odometry has no noise.
    """
    if then == now:
        return mean, covariance
    moved = between(np.array(then), np.array(now))
    noise = np.zeros((3, 3)) if motion is None else motion_covariance(moved, motion)
    return moved_by(mean, covariance, moved, noise)


class DeadReckoning(Part):
    """Adds up the odometry since a step, and since the last weighed scan, in pieces of one gate.

    Each piece has independent noise, as particles get it at each step. So the covariance is that
    of particles without measurement updates.
    """

    motion: MotionSettings
    bridge: BridgeSettings
    """Its gate defines a step."""
    covariance: Covariance = NO_NOISE
    """Covariance of `piece` in the frame of the step."""
    step: PoseTuple = ORIGIN
    piece: PoseTuple = ORIGIN
    """Odometry at the end of the last whole piece."""
    now: PoseTuple = ORIGIN
    """The newest odometry."""
    counted: PoseTuple | None = None
    """Odometry up to which `gates` are counted; None: there was no odometry."""
    gates: float = 0.0
    """The distance driven since the last weighed scan, in multiples of the bridge's gate."""

    def begin_at(self, odom_from_robot: PoseTuple) -> None:
        """Begin at a step; the odometry since the step becomes one motion."""
        self.covariance = NO_NOISE
        self.step = self.piece = odom_from_robot
        self._add_piece()

    def weighed_at(self, odom_from_robot: PoseTuple) -> None:
        """Begin to count gates at a weighed scan."""
        self.counted, self.gates = odom_from_robot, 0.0
        self._count_gates()

    def on_odometry(self, odom_from_robot: PoseTuple) -> None:
        self.now = odom_from_robot
        self._add_piece()
        self._count_gates()

    def _add_piece(self) -> None:
        if gates_between(self.piece, self.now, self.bridge) >= 1.0:
            self.covariance = covariance_tuple(self.moved()[1])
            self.piece = self.now

    def _count_gates(self) -> None:
        """Count the motion once it reaches a gate; smaller motions may be noise."""
        self.counted = self.counted or self.now
        gates = gates_between(self.counted, self.now, self.bridge)
        if gates >= 1.0:
            self.counted = self.now
            self.gates += gates

    def moved(self) -> tuple[Pose, NDArray[np.float64]]:
        """Return the motion since the step, (3,) in its frame, and its covariance, (3, 3)."""
        step, piece, now = np.array(self.step), np.array(self.piece), np.array(self.now)
        last = between(piece, now)
        if self.piece == self.step:  # most often: nothing to compose
            return last, motion_covariance(last, self.motion)
        before, noise = covariance_matrix(self.covariance), motion_covariance(last, self.motion)
        covariance = composed_covariance(between(step, piece), before, last, noise)
        return between(step, now), covariance
