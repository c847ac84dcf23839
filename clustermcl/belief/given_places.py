"""Candidate places around a given pose, or around the last pose of an earlier run."""

import math
from collections.abc import Sequence

import msgspec
import numpy as np
from msgspec.structs import replace

from clustermcl.belief.cluster_set import Candidate
from clustermcl.belief.overlaps import is_near
from clustermcl.filter.poses import between, compose
from clustermcl.filter.random_streams import Purpose, generator
from clustermcl.filter.settings import FilterSettings
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.message import Covariance, NumberOrNone, PoseTuple, Probability
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


class PriorPose(msgspec.Struct, frozen=True):
    """A pose from an earlier run; it is used until the first search has ended."""

    step: NumberOrNone
    odom_from_robot: PoseTuple
    pose: PoseTuple
    covariance: Covariance
    probability: Probability


def with_prior_pose(
    found: Sequence[Place],
    prior: PriorPose,
    odom_from_robot: PoseTuple,
    settings: FilterSettings,
) -> list[Candidate]:
    """Return the places of a search and the prior place, as candidates.

    A found place near the prior one gets its probability. Otherwise the prior place is added; if
    there is no room, the least probable found place is dropped.

    Args:
        found: most probable first; their shares are probabilities.
        prior: the place as it was after an earlier step; it is tracked from there.
        odom_from_robot: odometry now, by which the prior place is moved.
        settings: settings of the filter.
    """
    rules = settings.belief
    now = moved_pose(prior.pose, prior.odom_from_robot, odom_from_robot)
    means = [place.pose for place in found]
    is_there = is_near(means, [now], rules.merge_distance_m, rules.merge_heading_rad)
    there = int(np.argmax(is_there)) if is_there.any() else None
    kept = found if there is not None else found[: rules.max_clusters - 1]
    total = math.fsum(place.share for place in kept)
    if not kept or total <= 0.0:
        return [(_offered(now, prior, 1.0, settings), "prior pose")]
    left = (1.0 - prior.probability) / total
    scaled = [replace(place, share=place.share * left) for place in kept]
    if there is not None:
        raised = scaled[there].share + prior.probability
        scaled[there] = replace(scaled[there], share=raised)
    both: list[Candidate] = [(place, "first search") for place in scaled]
    if there is None:
        both.append((_offered(now, prior, prior.probability, settings), "prior pose"))
    return both


def _offered(
    mean: PoseTuple, prior: PriorPose, probability: float, settings: FilterSettings
) -> Place:
    start = candidate(
        probability,
        prior.pose,
        prior.covariance,
        seed=settings.seed,
        purpose=Purpose.LAST_POSE,
        entity=0,
        step=prior.step,
        odom_from_robot=prior.odom_from_robot,
    )
    return replace(start, pose=mean)
