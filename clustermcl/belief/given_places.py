"""Places around a given pose, or around the last pose of an earlier run."""

import numpy as np

from clustermcl.filter.poses import between, compose
from clustermcl.filter.random_streams import Purpose, generator
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.message import Covariance, PoseTuple
from clustermcl.protocol.pose_arrays import covariance_matrix, pose_tuple
from clustermcl.protocol.work import Particles, Place

GIVEN_PARTICLES = 1_000


def diagonal(position_sigma_m: float, heading_sigma_rad: float) -> Covariance:
    """Return the covariance of uncorrelated x, y [m^2] and heading [rad^2]."""
    place, turn = position_sigma_m**2, heading_sigma_rad**2
    return (place, 0.0, 0.0, 0.0, place, 0.0, 0.0, 0.0, turn)


def candidate(
    probability: float,
    mean: PoseTuple,
    covariance: Covariance,
    *,
    seed: int,
    purpose: Purpose,
    entity: int,
    step: int,
    odom_from_robot: PoseTuple,
) -> Place:
    """Return a candidate place with Gaussian particles, as it was after `step`.

    Negative eigenvalues of the covariance count as zero.
    """
    rng = generator(seed, purpose=purpose, entity=entity, step=max(step, 0))
    variances, axes = np.linalg.eigh(covariance_matrix(covariance))
    spread = rng.standard_normal((GIVEN_PARTICLES, 3)) * np.sqrt(np.maximum(variances, 0.0))
    sample = Particles(
        step=step,
        odom_from_robot=odom_from_robot,
        map_from_robot=ArrayBlob.of(np.array(mean) + spread @ axes.T, "float64"),
        log_weights=ArrayBlob.of(np.zeros(GIVEN_PARTICLES), "float64"),
    )
    return Place(share=probability, pose=mean, covariance=covariance, sample=sample)


def moved_pose(pose: PoseTuple, then: PoseTuple, now: PoseTuple) -> PoseTuple:
    """Return a pose after the robot has moved by odometry from `then` to `now`."""
    return pose_tuple(compose(np.array(pose), between(np.array(then), np.array(now))))
