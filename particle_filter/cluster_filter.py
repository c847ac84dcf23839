"""One cluster by ordinary MCL: resample, move, weigh (section 2 of the paper)."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import LogWeights, Pose, Poses
from particle_filter.evidence_model import way
from particle_filter.gaussian import fit_gaussian
from particle_filter.log_weights import multiplied, normalised_weights, shares
from particle_filter.motion import move, slipped
from particle_filter.resampling import resample, systematic
from particle_filter.sensor_model import Beams, SensorModel, ground_log_penalty
from particle_filter.settings import ClusterSettings, MotionSettings

_SLIP_EVERY = 4
"""One particle of so many is tried as one that has slipped."""
_SLIP_GAIN = 0.15
"""So much better must the best of them fit [nat/beam]."""


@dataclass(frozen=True)
class Cloud:
    """A weighted set of particles: the belief of one filter."""

    map_from_robot: Poses
    """(N, 3) x [m], y [m], heading [rad]."""
    log_weights: LogWeights
    """(N,); the weights sum to N, so that an even cloud has weights of one."""

    @classmethod
    def even(cls, map_from_robot: Poses) -> "Cloud":
        """A cloud whose particles count alike."""
        return cls(map_from_robot, np.zeros(len(map_from_robot)))

    @cached_property
    def _shares(self) -> tuple[NDArray[np.float64], float]:
        return shares(self.log_weights)

    @property
    def weights(self) -> NDArray[np.float64]:
        """(N,) the weights themselves, summing to one."""
        return self._shares[0]

    @property
    def effective_sample_size(self) -> float:
        """How many even particles would tell as much."""
        return self._shares[1]

    def gaussian(self) -> tuple[Pose, Poses]:
        """Mean pose and (3, 3) covariance, heading on the circle (section 4, last paragraph)."""
        return fit_gaussian(self.map_from_robot, self.weights)


@dataclass(frozen=True)
class Weighed:
    """A cloud after a scan, and what the scan said of it."""

    cloud: Cloud
    log_weight_sum: float
    """Log of the sum of w_{t-1} p(z_t | x_t); less log N it is the log average likelihood."""
    log_likelihood_per_beam: float
    """Best particle's, without the exponent."""
    best: Pose | None = None
    """(3,) the best particle; None where the scan tells nothing."""


def resampled(
    cloud: Cloud, count: int, settings: ClusterSettings, rng: np.random.Generator
) -> Cloud:
    """Draw `count` particles by weight where too few of them count; else carry the weights on."""
    if cloud.effective_sample_size >= settings.resample_below_ess * len(cloud.log_weights):
        return cloud
    chosen = systematic(cloud.weights, count, rng.random())
    return Cloud.even(cloud.map_from_robot.take(chosen, axis=0))  # thrice as fast as [chosen]


def weighed(
    cloud: Cloud, beams: Beams, model: SensorModel, exponent: float, share: float = 1.0
) -> Weighed:
    """Multiply the weights by the likelihood of a scan.

    Args:
        cloud: N particles.
        beams: the scan; without a valid beam it tells nothing and the evidence is one.
        model: weighs poses.
        exponent: on the likelihood of the scan; beams are not independent.
        share: of it that moves weights; the evidence is that of the whole scan.
    """
    count = len(cloud.log_weights)
    if beams.count == 0:
        return Weighed(cloud, math.log(count), math.nan)
    fit = model.log_likelihood(cloud.map_from_robot, beams)
    # Walls do not pass for free.
    penalty = ground_log_penalty(
        cloud.map_from_robot, model.grid, model.settings.not_free_log_penalty
    )
    log_weights, total = multiplied(cloud.log_weights, fit, exponent, penalty)
    if share < 1.0:
        log_weights, _ = multiplied(cloud.log_weights, fit, share * exponent, penalty)
    after = Cloud(cloud.map_from_robot, log_weights)
    best = int(np.argmax(fit))
    return Weighed(after, total, float(fit[best]) / beams.count, cloud.map_from_robot[best])


def pose_share(before_from_after: Pose, settings: ClusterSettings) -> float:
    """Share of a scan after such a motion (3,) that is new of where in a cloud the robot is.

    What earlier scans said of that is in the cloud, blurred by the motion since: as much of a scan
    counts as the motion has blurred, so a cloud gets no surer by looking more often.
    """
    if settings.view_distance_m == 0.0:
        return 1.0
    moved_m, turned_rad = way(before_from_after)
    return -math.expm1(-moved_m / settings.view_distance_m - turned_rad / settings.view_turn_rad)


def advanced(
    cloud: Cloud,
    before_from_after: Pose,
    beams: Beams,
    model: SensorModel,
    motion: MotionSettings,
    settings: ClusterSettings,
    rng: np.random.Generator,
    *,
    is_first: bool = False,
    particles: int | None = None,
) -> Weighed:
    """One step of MCL: draw from the cloud, move by odometry, weigh by the scan.

    A particle never leaves its cluster (eq. 14): all happens within this cloud.

    A step after which the best particle fits badly is tried again as one on which the robot has
    slipped; particles that have are taken up where they fit clearly better.

    Args:
        cloud: before.
        before_from_after: (3,) the motion, by odometry.
        beams: of the scan.
        model: weighs poses.
        motion: how far odometry errs.
        settings: of the cluster.
        rng: all chance of this step.
        is_first: no scan has been seen by this cloud, so all of this one is new.
        particles: how many a resampling draws; None: as many as there are.

    References:
        Section 2, routine 1-3; the draw is left out while enough particles count.
    """
    cloud = resampled(cloud, particles or len(cloud.log_weights), settings, rng)
    moved = move(cloud.map_from_robot, before_from_after, motion, rng)
    exponent = model.settings.scan_likelihood_exponent
    share = 1.0 if is_first else pose_share(before_from_after, settings)
    result = weighed(Cloud(moved, cloud.log_weights), beams, model, exponent, share)
    if motion.slip_probability > 0.0 and result.log_likelihood_per_beam < motion.slip_below_fit:
        some = slice(None, None, _SLIP_EVERY)
        back = slipped(cloud.map_from_robot[some], moved[some], before_from_after, rng)
        best_back = float(model.log_likelihood(back, beams).max()) / beams.count
        if best_back > result.log_likelihood_per_beam + _SLIP_GAIN:
            both = _with_slipped(cloud, moved, back, motion.slip_probability)
            again = weighed(both, beams, model, exponent, share)
            chosen = resample(again.cloud.log_weights, len(moved), rng)
            drawn = Cloud.even(both.map_from_robot[chosen])
            result = replace(again, cloud=drawn)
    correction = model.correction(result.cloud.map_from_robot, result.cloud.weights, beams)
    return replace(result, log_weight_sum=result.log_weight_sum - correction)


def _with_slipped(cloud: Cloud, moved: Poses, back: Poses, probability: float) -> Cloud:
    """The moved cloud and some particles that have slipped; all weigh what the cloud did."""
    each = math.log(probability * len(moved) / len(back))
    of_moved = cloud.log_weights + math.log1p(-probability)
    of_back = cloud.log_weights[::_SLIP_EVERY] + each
    return Cloud(np.concatenate([moved, back]), np.concatenate([of_moved, of_back]))


def drawn_from(
    sample: Poses,
    log_weights: LogWeights,
    settings: ClusterSettings,
    rng: np.random.Generator,
) -> Cloud:
    """A cluster's own particles from a handed-over sample, spread a little where it repeats.

    The kernel is Silverman's for the sample's covariance, so the cloud keeps its shape.

    Raises:
        ValueError: the sample is empty or has no weight.
    """
    chosen = sample[resample(log_weights, settings.particles, rng)]
    _, covariance = fit_gaussian(sample, normalised_weights(log_weights))
    width = len(sample) ** (-1.0 / 7.0) * (4.0 / 5.0) ** (1.0 / 7.0)  # 3 dimensions
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0)) * width * 0.5
    return Cloud.even(chosen + rng.standard_normal(chosen.shape) * spread)
