"""Ordinary MCL as a baseline, built from the same components: one particle set, no clusters.

It starts with particles over the whole free space, shrinks to the number that all clusters have
together, and is never restarted. Its places are clusters of the particles at each step, as in
nav2. Variants add visibility, random particles and KLD-sampling.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import msgspec
import numpy as np

from coordinator.belief.outcome import Outcome
from evaluation.one_cloud import (
    RESAMPLE_BELOW_ESS,
    OneCloud,
    start_particles,
    uniform_over_free_space,
)
from evaluation.recovery import Recovery, RecoveryGains
from evaluation.visible_field_model import VisibleFieldModel
from particle_filter.arrays import Poses
from particle_filter.cluster_filter import ParticleSet
from particle_filter.likelihood_field_model import LikelihoodFieldModel
from particle_filter.places import FoundPlace, places_of
from particle_filter.random_streams import Purpose, generator
from particle_filter.resampling import resample
from particle_filter.sensor_model import SensorModel
from particle_filter.settings import FilterSettings
from protocol.answers import Hypothesis
from protocol.pose_arrays import covariance_tuple, pose_tuple
from protocol.steps import Scan
from worker.jobs import scan_beams

KLD_ERROR, KLD_LEAST_PARTICLES = 0.05, 500
"""nav2's `pf_err` and `min_particles`; the maximum is the number without KLD-sampling."""
KLD_BIN_M, KLD_BIN_RAD = 0.1, math.radians(5.0)
KLD_UPPER_QUANTILE = 2.326
"""Of the standard normal distribution at 0.99: the bound holds with this probability."""
RAYS_PER_POSE = 6
"""Beams cast per pose, different ones for neighbouring poses: a weight errs by 0.2 nat, and a step
takes a third of the time that half of all beams would."""


@dataclass(frozen=True, kw_only=True)
class Variant:
    """Additions to ordinary MCL."""

    visibility: bool = False
    """Penalise occluded beam ends, see `VisibleFieldModel`; no effect in a beam model, which casts
    all rays anyway."""
    recovery: RecoveryGains | None = None
    """Add random particles while scans fit worse than before."""
    kld: bool = False
    """KLD-sampling after shrinking."""


PLAIN = Variant()


def outcomes(
    scans: Iterable[Scan],
    model: SensorModel,
    settings: FilterSettings,
    variant: Variant = PLAIN,
) -> Iterator[tuple[Scan, Outcome]]:
    """Yield the belief after every step; arguments as for Cluster-MCL in one process."""
    if variant.visibility:
        model = _with_visibility(model, settings)
    one: OneCloud | None = None
    recovery = Recovery(variant.recovery) if variant.recovery else None
    before = None
    for scan in scans:
        rng = generator(settings.seed, purpose=Purpose.SEARCH, entity=0, step=scan.step)
        if one is None:
            start = uniform_over_free_space(model.grid, start_particles(model.grid), rng)
            one = OneCloud(model, settings, start, kept_particles(settings))
        else:
            random_share = recovery.random_share if recovery else 0.0
            kld = variant.kld and one.shrunk
            one.particles = redrawn(one.particles, random_share, model, settings, rng, kld=kld)
        after = np.array(scan.odom_from_robot)
        result = one.advance(before, after, scan_beams(scan, model), rng)
        before = after
        if recovery:
            log_count = math.log(len(result.particles.log_weights))
            recovery.on_likelihood(result.log_weight_sum - log_count)
        rules = settings.search
        yield (
            scan,
            _outcome(scan, places_of(one.particles, rules, rules.min_place_share, rng), settings),
        )


def kept_particles(settings: FilterSettings) -> int:
    """Return the number of particles that all clusters have together."""
    each = settings.belief.max_clusters * settings.cluster.particles
    return settings.belief.particles or each


def _with_visibility(model: SensorModel, settings: FilterSettings) -> SensorModel:
    """Return the model that penalises occluded ends, unless that is off."""
    if not isinstance(model, LikelihoodFieldModel) or model.settings.visibility_particles == 0:
        return model
    sensor = msgspec.structs.replace(
        model.settings, visibility_beam_stride=max(model.settings.max_beams // RAYS_PER_POSE, 1)
    )
    most = kept_particles(settings)
    return VisibleFieldModel(model.grid, model.field, model.pyramid, model.jumps, sensor, most)


def redrawn(
    particles: ParticleSet,
    random_share: float,
    model: SensorModel,
    settings: FilterSettings,
    rng: np.random.Generator,
    *,
    kld: bool,
) -> ParticleSet:
    """Return the particles resampled with random particles or by KLD-sampling.

    Without either they are unchanged: `OneCloud` resamples by itself.
    """
    count = len(particles.log_weights)
    crowded = particles.effective_sample_size < RESAMPLE_BELOW_ESS * count
    if random_share == 0.0 and not (kld and crowded):
        return particles
    if kld:
        most = kept_particles(settings)
        poses = particles.map_from_robot
        count = sufficient_particles(poses, KLD_ERROR, min(KLD_LEAST_PARTICLES, most), most)
    chosen = resample(particles.log_weights, count, rng)
    poses = particles.map_from_robot[chosen]
    random = np.flatnonzero(rng.random(count) < random_share)
    if len(random):
        poses[random] = uniform_over_free_space(model.grid, len(random), rng)
    return ParticleSet.even(poses)


def sufficient_particles(map_from_robot: Poses, error: float, least: int, most: int) -> int:
    """Return the number of particles that KLD-sampling asks for.

    With that many, the Kullback-Leibler distance to the true belief is probably below a bound.

    Args:
        map_from_robot: (N, 3) poses; the bins that they occupy are counted.
        error: the bound.
        least: lower limit of the result.
        most: upper limit of the result.

    References:
        Fox, KLD-sampling (2001), eq. 9; Probabilistic Robotics (2005), table 8.4.
    """
    bins = np.floor(map_from_robot / np.array([KLD_BIN_M, KLD_BIN_M, KLD_BIN_RAD])).astype(np.int64)
    bins -= bins.min(axis=0)
    spans = bins.max(axis=0) + 1
    occupied = len(np.unique((bins[:, 0] * spans[1] + bins[:, 1]) * spans[2] + bins[:, 2]))
    if occupied < 2:
        return least
    k = occupied - 1.0
    share = 2.0 / (9.0 * k)
    count = k / (2.0 * error) * (1.0 - share + math.sqrt(share) * KLD_UPPER_QUANTILE) ** 3
    return min(max(math.ceil(count), least), most)


def _outcome(scan: Scan, places: list[FoundPlace], settings: FilterSettings) -> Outcome:
    hypotheses = tuple(
        Hypothesis(
            cluster=index,
            probability=place.share,
            log_probability=float(np.log(place.share)),
            mean=pose_tuple(place.mean),
            covariance=covariance_tuple(place.covariance),
            effective_sample_size=0.0,
            age_steps=0,
        )
        for index, place in enumerate(places)
    )
    sure = bool(places) and places[0].share >= settings.belief.localized_probability
    return Outcome(
        step=scan.step,
        state="localized" if sure else "ambiguous" if places else "searching",
        hypotheses=hypotheses,
        elsewhere_probability=0.0,
        searching=False,
        missing=(),
        begin={},
        events=(),
    )
