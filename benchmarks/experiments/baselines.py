"""Baselines of the experiments: the paper's letter, and additions to ordinary MCL.

The additions are other gains and KLD-sampling.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from msgspec.structs import replace as changed

from benchmarks.experiments import mcl
from benchmarks.experiments.case import Algorithm
from benchmarks.experiments.mcl import OrdinaryMCL, RecoveryGains, kept_particles
from clustermcl.belief.outcome import Outcome
from clustermcl.evaluation.run import Outcomes
from clustermcl.filter.arrays import Poses
from clustermcl.filter.cluster.cluster_filter import ParticleSet
from clustermcl.filter.laser.sensor_model import SensorModel
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

    Beams are independent, every step resamples, the prior of a cluster is squared (eq. 17),
    evidence is not tempered, K clusters are kept, particles never change their cluster (eq. 14) and
    kidnapping is impossible.
    """
    return changed(
        settings,
        sensor=changed(settings.sensor, scan_likelihood_exponent=1.0),
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


KLD_ERROR, KLD_LEAST_PARTICLES = 0.05, 500
"""nav2's `pf_err` and `min_particles`; the maximum is the number without KLD-sampling."""
KLD_BIN_M, KLD_BIN_RAD = 0.1, math.radians(5.0)
KLD_UPPER_QUANTILE = 2.326
"""Of the standard normal distribution at 0.99: the bound holds with this probability."""
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


ALGORITHMS: dict[Algorithm, Outcomes] = {
    "cluster-mcl": in_process.outcomes,
    "paper-letter": letter_outcomes,
    "mcl": mcl.outcomes,
    "amcl": partial(mcl.outcomes, gains=mcl.AMCL_GAINS),
    "amcl-tuned": partial(mcl.outcomes, gains=TUNED_GAINS),
    "amcl-kld": partial(mcl.outcomes, gains=mcl.AMCL_GAINS, filter_class=KldSampling),
}
"""Cluster-MCL; the same exactly as in the paper; ordinary MCL; with augmented recovery; with our
recovery gains; with KLD-sampling."""
