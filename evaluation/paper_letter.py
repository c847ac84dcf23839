"""Cluster-MCL as the paper has it to the letter, as far as that is a matter of settings."""

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
"""Of a cluster."""
CLUSTERS = 10
"""K."""


def outcomes(
    scans: Iterable[Scan], model: SensorModel, settings: FilterSettings
) -> Iterator[tuple[Scan, Outcome]]:
    """The belief after every step; arguments as for Cluster-MCL in one process."""
    settings = to_the_letter(settings)
    if isinstance(model, LikelihoodFieldModel):
        model = replace(model, settings=settings.sensor)
    yield from in_process.outcomes(scans, model, settings)


def to_the_letter(settings: FilterSettings) -> FilterSettings:
    """The same settings, but for what docs/paper.md calls a departure.

    Beams are independent and see through walls, every step draws, the prior of a cluster is
    squared (eq. 17), a step tells all that it seems to tell, K clusters are kept, nobody changes
    from one to another (eq. 14) and nobody is lifted elsewhere.
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
