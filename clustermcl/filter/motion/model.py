"""Odometry motion models: particles move as the robot did, each with its own error."""

from math import floor, pi

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Pose, Poses
from clustermcl.filter.kernels.compiled import kernel, plain
from clustermcl.filter.kernels.elementary_functions import cos_sin, logarithms
from clustermcl.filter.motion.noise import along_across_turn, turn_drive_turn
from clustermcl.filter.settings import MotionSettings


def move(
    map_from_robot: Poses,
    before_from_after: Pose,
    settings: MotionSettings,
    noise: NDArray[np.float32],
    by_scans: Pose | None = None,
) -> Poses:
    """Draw every particle's next pose from p(x_t | u_t, x_{t-1}).

    The (3,) motion is by odometry, in the frame before it. The (3, N) noise is standard normal:
    along the drive, across the drive and turn (omnidirectional), or first turn, drive and second
    turn (differential).

    A (3,) motion `by_scans` contradicts odometry: each is right with probability 1/2, and every
    second particle moves by the scans.

    Returns:
        (N, 3) new array; headings in [-pi, pi). Without motion there is no noise.

    References:
        Probabilistic Robotics (2005), table 5.6 (differential); nav2_amcl's OmniMotionModel
        (omnidirectional). nav2's alphas are variances: our noise is the root of an alpha.
    """
    poses = plain(map_from_robot)
    if by_scans is not None:
        moved = move(poses, before_from_after, settings, noise)
        odd = np.ascontiguousarray(noise[:, 1::2])
        moved[1::2] = move(poses[1::2], by_scans, settings, odd)
        return moved
    if settings.model == "differential":
        return _turn_drive_turn(poses, turn_drive_turn(before_from_after, settings), noise)
    along = along_across_turn(before_from_after, settings)
    return _drive_along_bearing(poses, along, noise)


# Bearings in single precision: a drive of a metre errs by 0.2 um at most.
@kernel
def _drive_along_bearing(
    poses: Poses, motion: tuple[float, ...], noise: NDArray[np.float32]
) -> Poses:
    bearing, drive, turn, along_sigma, across_sigma, turn_sigma = motion
    moved = np.empty_like(poses)
    for i in range(len(poses)):
        along = drive + along_sigma * np.float64(noise[0, i])
        across = across_sigma * np.float64(noise[1, i])
        c, s = cos_sin(poses[i, 2] + bearing)
        moved[i, 0] = poses[i, 0] + along * c - across * s
        moved[i, 1] = poses[i, 1] + along * s + across * c
        moved[i, 2] = _wrapped(poses[i, 2] + turn + turn_sigma * np.float64(noise[2, i]))
    return moved


@kernel
def _turn_drive_turn(poses: Poses, motion: tuple[float, ...], noise: NDArray[np.float32]) -> Poses:
    turn_1, drive, turn_2, turn_1_sigma, drive_sigma, turn_2_sigma = motion
    moved = np.empty_like(poses)
    for i in range(len(poses)):
        turned_1 = turn_1 + turn_1_sigma * np.float64(noise[0, i])
        driven = drive + drive_sigma * np.float64(noise[1, i])
        turned_2 = turn_2 + turn_2_sigma * np.float64(noise[2, i])
        c, s = cos_sin(poses[i, 2] + turned_1)
        moved[i, 0] = poses[i, 0] + driven * c  # table 5.6, line 8
        moved[i, 1] = poses[i, 1] + driven * s  # table 5.6, line 9
        moved[i, 2] = _wrapped(poses[i, 2] + turned_1 + turned_2)  # table 5.6, line 10
    return moved


@kernel
def _wrapped(heading: float) -> float:
    """Compiled `poses.wrap_angle`."""
    wrapped = heading - 2.0 * pi * floor((heading + pi) / (2.0 * pi))
    return wrapped if -pi <= wrapped < pi else -pi


_UNIT, _TO_ANGLE = np.float32(2.0**-32), 2.0 * np.pi * 2.0**-32
_HALF, _TWO = np.float32(0.5), np.float32(2.0)
_PAIRS = 2048
"""Number of pairs computed together, whose numbers fit into the nearest cache."""


def standard_normals(rng: np.random.Generator, rows: int, count: int) -> NDArray[np.float32]:
    """Draw independent standard normal numbers in single precision (Box and Muller).

    A 64-bit word gives two numbers; its halves give radius and angle. No branch depends on the
    numbers, so vector instructions compute them, several times as fast as
    `Generator.standard_normal`. No number is beyond 6.8.

    Returns:
        (rows, count), of ceil(rows * count / 2) words of 64 bits.

    References:
        Box and Muller, "A note on the generation of random normal deviates" (1958).
    """
    pairs = (rows * count + 1) // 2
    words = np.asarray(rng.bit_generator.random_raw(pairs))
    normals = np.empty((2, pairs), np.float32)
    _box_muller(words.view(np.uint32), normals)
    return normals.reshape(-1)[: rows * count].reshape(rows, count)


@kernel
def _box_muller(halves: NDArray[np.uint32], normals: NDArray[np.float32]) -> None:
    """Write (2, n) normal numbers, made of (2 n,) halves of random words, to `normals`."""
    count = normals.shape[1]
    uniform, angle = np.empty(_PAIRS, np.float32), np.empty(_PAIRS)
    for start in range(0, count, _PAIRS):
        size = min(_PAIRS, count - start)
        first, second = normals[0, start : start + size], normals[1, start : start + size]
        own = halves[2 * start : 2 * (start + size)]
        for i in range(size):
            uniform[i] = (np.float32(own[2 * i]) + _HALF) * _UNIT
            angle[i] = np.float64(own[2 * i + 1]) * _TO_ANGLE
        logarithms(uniform[:size], first)
        for i in range(size):
            radius = np.sqrt(max(-_TWO * first[i], np.float32(0.0)))
            c, s = cos_sin(angle[i])
            first[i], second[i] = radius * c, radius * s
