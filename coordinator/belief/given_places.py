"""Particles around a given pose, or around the last pose of an earlier run."""

import numpy as np

from particle_filter.random_streams import Purpose, generator
from protocol.arrays import ArrayBlob
from protocol.message import Covariance, PoseTuple
from protocol.pose_arrays import covariance_matrix
from protocol.work import Particles, Place

GIVEN_PARTICLES = 1_000


def diagonal(position_sigma_m: float, heading_sigma_rad: float) -> Covariance:
    """Return the covariance of uncorrelated x, y [m^2] and heading [rad^2]."""
    place, turn = position_sigma_m**2, heading_sigma_rad**2
    return (place, 0.0, 0.0, 0.0, place, 0.0, 0.0, 0.0, turn)


def cloud(
    mean: PoseTuple,
    covariance: Covariance,
    rng: np.random.Generator,
    *,
    step: int,
    odom_from_robot: PoseTuple,
) -> Particles:
    """Return Gaussian particles around a pose; negative eigenvalues of the covariance are zero."""
    variances, axes = np.linalg.eigh(covariance_matrix(covariance))
    spread = rng.standard_normal((GIVEN_PARTICLES, 3)) * np.sqrt(np.maximum(variances, 0.0))
    return Particles(
        step=step,
        odom_from_robot=odom_from_robot,
        map_from_robot=ArrayBlob.of(np.array(mean) + spread @ axes.T, "float64"),
        log_weights=ArrayBlob.of(np.zeros(GIVEN_PARTICLES), "float64"),
    )


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
    """Return a candidate place with Gaussian particles, as it was after `step`."""
    rng = generator(seed, purpose=purpose, entity=entity, step=max(step, 0))
    sample = cloud(mean, covariance, rng, step=step, odom_from_robot=odom_from_robot)
    return Place(share=probability, pose=mean, covariance=covariance, sample=sample)
