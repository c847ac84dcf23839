"""One cluster by ordinary MCL: resample, move, weigh (section 2 of the paper)."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import LogWeights, Pose, Poses
from clustermcl.filter.cluster.gaussian import fit_gaussian
from clustermcl.filter.laser.evidence_model import scan_exponent, share_by_fit
from clustermcl.filter.laser.sensor_model import Beams, SensorModel, ground_log_penalty
from clustermcl.filter.log_weights import multiplied, normalised_weights, weights_and_ess
from clustermcl.filter.motion.model import move, standard_normals
from clustermcl.filter.poses import wrap_angle
from clustermcl.filter.resampling import resample, systematic
from clustermcl.filter.settings import ClusterSettings, MotionSettings

_LEAST_VARIANCE = 1e-6
"""Least variance of a cloud, so that equal particles have a density [m^2], [rad^2]."""


@dataclass(frozen=True)
class ParticleSet:
    """A set of weighted particles."""

    map_from_robot: Poses
    """(N, 3) x [m], y [m], heading [rad]."""
    log_weights: LogWeights
    """(N,); the weights sum to N, so equal weights are one."""

    @classmethod
    def even(cls, map_from_robot: Poses) -> "ParticleSet":
        return cls(map_from_robot, np.zeros(len(map_from_robot)))

    @cached_property
    def _weights_and_ess(self) -> tuple[NDArray[np.float64], float]:
        return weights_and_ess(self.log_weights)

    @property
    def weights(self) -> NDArray[np.float64]:
        """(N,) linear weights that sum to one."""
        return self._weights_and_ess[0]

    @property
    def effective_sample_size(self) -> float:
        """Effective sample size, between 1 and N; see `weights_and_ess`."""
        return self._weights_and_ess[1]

    def gaussian(self) -> tuple[Pose, Poses]:
        """Return the (3,) mean pose and (3, 3) covariance (section 4, last paragraph)."""
        return fit_gaussian(self.map_from_robot, self.weights)


@dataclass(frozen=True)
class MeasurementUpdate:
    """A particle set after a scan, and the evidence of the scan."""

    expected: ParticleSet
    """The particles before it."""
    particles: ParticleSet
    log_weight_sum: float
    """Log of the sum of w_{t-1} p(z_t | x_t) over N particles whose weights sum to N."""
    log_likelihood: LogWeights | None = None
    """(N,) of the scan at the particles, times its exponent; None if it has no beams."""

    @property
    def best(self) -> Pose | None:
        """(3,) the most probable particle; None if the scan has no beams."""
        if self.log_likelihood is None:
            return None
        index = _most_probable(self.expected, self.log_likelihood)
        best: Pose = self.expected.map_from_robot[index]
        return best


def resampled(
    particles: ParticleSet, count: int, settings: ClusterSettings, rng: np.random.Generator
) -> ParticleSet:
    """Draw `count` particles by weight if the effective sample size is too small.

    Else return the same particles.
    """
    if particles.effective_sample_size >= settings.resample_below_ess * len(particles.log_weights):
        return particles
    chosen = systematic(particles.weights, count, rng.random())
    # `take` is three times as fast as indexing.
    return ParticleSet.even(particles.map_from_robot.take(chosen, axis=0))


def measurement_update(
    particles: ParticleSet, beams: Beams, model: SensorModel, share: float = 1.0
) -> MeasurementUpdate:
    """Multiply the weights by the likelihood of a scan; without beams, they stay.

    If less than all of the scan is new, its `share`, times `share_by_fit`, is a further factor of
    the log-likelihood and of the penalty for ground that is not free, for the weights but not for
    the evidence.
    """
    poses, before = particles.map_from_robot, particles.log_weights
    if beams.count == 0:
        return MeasurementUpdate(particles, particles, math.log(len(before)))
    fit, exponent = model.log_likelihood(poses, beams), scan_exponent(beams.count, model.settings)
    # The likelihood field is high inside walls, where no robot can be.
    penalty = ground_log_penalty(poses, model.grid, model.settings.not_free_log_penalty)
    log_weights, total = multiplied(before, fit, exponent, penalty)
    if share < 1.0:
        share *= share_by_fit(float(fit.max()) / beams.count, model.settings)
        log_weights, _ = multiplied(before, fit, share * exponent, share * penalty)
    return MeasurementUpdate(particles, ParticleSet(poses, log_weights), total, exponent * fit)


def _most_probable(expected: ParticleSet, log_likelihood: LogWeights) -> int:
    """Return the index of the particle with the largest posterior density.

    Its prior is the Gaussian of the expected particles. The one that fits best is often far from
    all others, along moved walls or at the edge of a wide cloud.
    """
    mean, covariance = expected.gaussian()
    off = expected.map_from_robot - mean
    off[:, 2] = wrap_angle(off[:, 2])
    variances, axes = np.linalg.eigh(covariance)
    scaled = off @ (axes / np.sqrt(np.maximum(variances, _LEAST_VARIANCE)))
    return int(np.argmax(log_likelihood - 0.5 * np.einsum("ni,ni->n", scaled, scaled)))


def new_share(before_from_after: Pose, settings: ClusterSettings) -> float:
    """Return the share of a scan that is new, after a motion (3,): a standing robot learns nothing.

    By this share it counts for the pose within a cluster, because motion has made the pose less
    certain since the last scan, and for the question whether the robot is at any cluster.
    """
    if settings.view_distance_m == 0.0:
        return 1.0
    x, y, turn = before_from_after.tolist()
    moved_m = math.hypot(x, y)
    return -math.expm1(-moved_m / settings.view_distance_m - abs(turn) / settings.view_turn_rad)


def mcl_step(
    particles: ParticleSet,
    before_from_after: Pose,
    beams: Beams,
    model: SensorModel,
    motion: MotionSettings,
    settings: ClusterSettings,
    rng: np.random.Generator,
    *,
    is_first: bool = False,
    count: int | None = None,
    by_scans: Pose | None = None,
) -> MeasurementUpdate:
    """Resample, move by odometry, and weigh by a scan.

    Particles never leave their cluster (eq. 14).

    All of the particles' first scan is new. A resampling draws `count` particles; None: as many as
    there are. `by_scans` as in `move`.

    References:
        Section 2, routine 1-3; the draw is omitted while the effective sample size suffices.
    """
    particles = resampled(particles, count or len(particles.log_weights), settings, rng)
    noise = standard_normals(rng, 3, len(particles.log_weights))
    moved = move(particles.map_from_robot, before_from_after, motion, noise, by_scans)
    share = 1.0 if is_first else new_share(before_from_after, settings)
    return measurement_update(ParticleSet(moved, particles.log_weights), beams, model, share)


def regularised_resample(
    sample: Poses, log_weights: LogWeights, count: int, rng: np.random.Generator
) -> ParticleSet:
    """Draw equally weighted particles from a weighted sample, and add noise to each.

    The noise has half the width of Silverman's kernel for the sample's variances.

    Raises:
        ValueError: the (M, 3) sample is empty or has no weight.

    References:
        Musso, Oudjane and Le Gland, "Improving regularised particle filters" (2001).
    """
    chosen = sample[resample(log_weights, count, rng)]
    _, covariance = fit_gaussian(sample, normalised_weights(log_weights))
    width = len(sample) ** (-1.0 / 7.0) * (4.0 / 5.0) ** (1.0 / 7.0)  # 3 dimensions
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0)) * width * 0.5
    return ParticleSet.even(chosen + rng.standard_normal(chosen.shape) * spread)
