"""Cluster-MCL exactly as in the paper, as far as settings allow."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

from msgspec.structs import replace as changed

from coordinator.belief.outcome import Outcome
from evaluation import in_process
from particle_filter.likelihood_field_model import LikelihoodFieldModel
from particle_filter.sensor_model import SensorModel
from particle_filter.settings import FilterSettings
from protocol.steps import Scan

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
    yield from in_process.outcomes(scans, model, settings)


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
            squared_prior=True,
            max_clusters=CLUSTERS,
            particles=0,
            least_probability=0.0,
            transition_probability=0.0,
            kidnapping_probability=0.0,
            view_distance_m=0.0,
            evidence_noise=0.0,
            evidence_misfit=math.inf,
        ),
    )
