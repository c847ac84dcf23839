"""Cluster-MCL exactly as in the paper, as far as settings allow."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

from msgspec.structs import replace as changed

from coordinator.belief.outcome import Outcome
from evaluation.in_process import InProcess
from particle_filter.likelihood_field_model import LikelihoodFieldModel
from particle_filter.sensor_model import SensorModel
from particle_filter.settings import FilterSettings
from protocol.steps import Scan
from protocol.work import Report, TrackReport

PARTICLES = 300
"""Particles of a cluster."""
CLUSTERS = 10
"""The paper's K."""


def outcomes(
    scans: Iterable[Scan], model: SensorModel, settings: FilterSettings
) -> Iterator[tuple[Scan, Outcome]]:
    """Yield the belief after every step; arguments as for Cluster-MCL in one process."""
    settings = to_the_letter(settings)
    if isinstance(model, LikelihoodFieldModel):
        model = replace(model, settings=settings.sensor)
    process = SquaredPrior(model, settings)
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
            transition_probability=0.0,
            kidnapping_probability=0.0,
            view_distance_m=0.0,
            evidence_noise=0.0,
            evidence_residual=math.inf,
        ),
    )
