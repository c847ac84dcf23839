"""Cluster-MCL as the paper has it to the letter, as far as that is a matter of settings."""

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
_NO_BOUND = 1e9


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
    squared (eq. 17), a step may tell anything, and nobody changes from one cluster to another
    (eq. 14).
    """
    return changed(
        settings,
        sensor=changed(settings.sensor, scan_likelihood_exponent=1.0, visibility_particles=0),
        cluster=changed(settings.cluster, particles=PARTICLES, resample_below_ess=1.0),
        belief=changed(
            settings.belief,
            squared_prior=True,
            transition_probability=0.0,
            evidence_bound=_NO_BOUND,
        ),
    )
