"""Baselines of the experiments: the paper's letter, and additions to ordinary MCL.

The additions are visibility in each particle's weight, other gains, and KLD-sampling.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from msgspec.structs import replace as changed

from benchmarks.experiments import mcl
from benchmarks.experiments.case import Algorithm
from benchmarks.experiments.mcl import OrdinaryMCL, RecoveryGains, kept_particles
from clustermcl.belief.outcome import Outcome
from clustermcl.evaluation.run import Outcomes
from clustermcl.filter.arrays import LogWeights, Poses
from clustermcl.filter.cluster.cluster_filter import ParticleSet
from clustermcl.filter.laser.sensor_model import Beams, SensorModel
from clustermcl.filter.settings import FilterSettings
from clustermcl.jobs import in_process
from clustermcl.jobs.in_process import InProcess
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.work import Report, TrackReport

PARTICLES = 300
"""Particles of a cluster."""
CLUSTERS = 10
"""The paper's K."""


def letter_outcomes(
    scans: Iterable[Scan], model: SensorModel, settings: FilterSettings
) -> Iterator[tuple[Scan, Outcome]]:
    """Yield the belief after every step; arguments as for Cluster-MCL in one process."""
    settings = to_the_letter(settings)
    process = SquaredPrior(replace(model, settings=settings.sensor), settings)
    for scan in scans:
        yield scan, process.advance(scan)


class SquaredPrior(InProcess):
    """Cluster-MCL whose evidence holds the prior: Bayes' rule then squares it (eq. 16 and 17)."""

    def _reports(self, scan: Scan) -> list[Report]:
        log_prior = {c.job_id: c.log_probability for c in self.ensemble.clusters.all()}
        return [
            changed(report, log_weight_sum=report.log_weight_sum + log_prior[report.job_id])
            if isinstance(report, TrackReport)
            else report
            for report in super()._reports(scan)
        ]


def to_the_letter(settings: FilterSettings) -> FilterSettings:
    """Return the settings without the departures of docs/paper.md.

    Beams are independent and ignore occlusion, every step resamples, the prior of a cluster is
    squared (eq. 17), evidence is not tempered, K clusters are kept, particles never change their
    cluster (eq. 14) and kidnapping is impossible.
    """
    return changed(
        settings,
        sensor=changed(settings.sensor, scan_likelihood_exponent=1.0, visibility_particles=0),
        cluster=changed(
            settings.cluster, particles=PARTICLES, resample_below_ess=1.0, view_distance_m=0.0
        ),
        belief=changed(
            settings.belief,
            max_clusters=CLUSTERS,
            particles=0,
            least_probability=0.0,
            piece_evidence=0.0,
            kidnapping_probability=0.0,
        ),
    )


@dataclass(frozen=True, eq=False)
class VisibleFieldModel(SensorModel):
    """Weighs poses by the field and by occlusion.

    Cluster-MCL corrects the evidence of whole clusters for occluded ends, by an average over a few
    poses (`correction`). A single particle set has no such evidence, so each pose's weight is
    corrected: by the same share of the same sum, with the same tolerance.
    """

    most_poses: int
    """Most poses for which rays are cast; more, as in a search's first steps, use only the field,
    which is a hundred times faster."""

    def log_likelihood(self, map_from_robot: Poses, beams: Beams) -> LogWeights:
        """Return (N,) log p(z | x), a sum over beams, without the exponent."""
        field = super().log_likelihood(map_from_robot, beams)
        if len(map_from_robot) > self.most_poses:
            return field
        tolerated = self.settings.occlusion_tolerance * beams.count
        occluded = np.maximum(self.occluded(map_from_robot, beams) - tolerated, 0.0)
        return np.asarray(field - self.settings.occlusion_weight * occluded)


KLD_ERROR, KLD_LEAST_PARTICLES = 0.05, 500
"""nav2's `pf_err` and `min_particles`; the maximum is the number without KLD-sampling."""
KLD_BIN_M, KLD_BIN_RAD = 0.1, math.radians(5.0)
KLD_UPPER_QUANTILE = 2.326
"""Of the standard normal distribution at 0.99: the bound holds with this probability."""
RAYS_PER_POSE = 6
"""Beams cast per pose, different ones for neighbouring poses: a weight errs by 0.2 nat, and a step
takes a third of the time that half of all beams would."""
TUNED_GAINS = RecoveryGains(slow=0.01, fast=0.3)
"""Tuned by us, on seeds that no experiment uses; docs/decisions.md."""


class KldSampling(OrdinaryMCL):
    """Ordinary MCL with KLD-sampling once it has shrunk."""

    def redrawn(
        self, particles: ParticleSet, rng: np.random.Generator, count: int | None = None
    ) -> ParticleSet:
        """Resample to the number of particles that KLD-sampling needs."""
        recovers = self._recovery is not None and self._recovery.random_share > 0.0
        if self.steps >= mcl.SHRINKING_STEPS and (recovers or mcl.is_degenerate(particles)):
            most = kept_particles(self._settings)
            least = min(KLD_LEAST_PARTICLES, most)
            count = sufficient_particles(particles.map_from_robot, KLD_ERROR, least, most)
        return super().redrawn(particles, rng, count)


def sufficient_particles(map_from_robot: Poses, error: float, least: int, most: int) -> int:
    """Return the number of particles that KLD-sampling needs.

    With this number the Kullback-Leibler distance to the true belief is probably below a bound.

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


def with_visibility(model: SensorModel, settings: FilterSettings) -> SensorModel:
    """Return the model that penalises occluded ends."""
    if model.settings.visibility_particles == 0:
        return model
    sensor = changed(
        model.settings, visibility_beam_stride=max(model.settings.max_beams // RAYS_PER_POSE, 1)
    )
    most = kept_particles(settings)
    return VisibleFieldModel(model.grid, sensor, model.pyramid, model.jumps, model.field, most)


def visible_outcomes(
    scans: Iterable[Scan],
    model: SensorModel,
    settings: FilterSettings,
    gains: RecoveryGains | None = None,
    filter_class: type[OrdinaryMCL] = OrdinaryMCL,
) -> Iterator[tuple[Scan, Outcome]]:
    """Yield the belief of ordinary MCL with visibility after every step."""
    followed = filter_class(with_visibility(model, settings), settings, gains)
    for scan in scans:
        yield scan, followed.advance(scan)


ALGORITHMS: dict[Algorithm, Outcomes] = {
    "cluster-mcl": in_process.outcomes,
    "paper-letter": letter_outcomes,
    "mcl": mcl.outcomes,
    "mcl-visibility": visible_outcomes,
    "amcl": partial(mcl.outcomes, gains=mcl.AMCL_GAINS),
    "amcl-visibility": partial(visible_outcomes, gains=mcl.AMCL_GAINS),
    "amcl-tuned": partial(visible_outcomes, gains=TUNED_GAINS),
    "amcl-kld": partial(visible_outcomes, gains=mcl.AMCL_GAINS, filter_class=KldSampling),
}
"""Cluster-MCL; the same exactly as in the paper; ordinary MCL, plain and with visibility; both
with augmented recovery; with our recovery gains and visibility; with KLD-sampling and
visibility."""
