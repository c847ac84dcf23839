"""Checks of what workers send: no malformed job, and no more than the settings allow."""

from msgspec.structs import replace

from clustermcl.filter.settings import FilterSettings
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.validity import problem_of
from clustermcl.protocol.work import Report, SearchReport, TrackReport, WorkerState


def checked(report: Report, settings: FilterSettings) -> Report:
    """Return a report without its snapshot if that has more particles than the settings allow.

    The report itself counts: its worker may have begun the job with earlier settings.

    Raises:
        MalformedMessageError: the report has more places, or particles of them, than allowed.
    """
    if isinstance(report, TrackReport):
        snapshot = report.snapshot
        is_large = snapshot and snapshot.log_weights.shape[0] > settings.cluster.particles
        return replace(report, snapshot=None) if is_large else report
    if isinstance(report, SearchReport):
        rules, found = settings.search, report.places
        places, particles = len(found), found.particles.shape[0]
        most_particles = settings.belief.max_clusters * rules.hand_over_particles + rules.places
        if places > rules.places or particles > most_particles:
            raise MalformedMessageError(
                expected="SearchReport",
                problem=f"{places} places and {particles} particles of them, "
                f"at most {rules.places} and {most_particles} by the settings",
                kind="more than its job allows",
            )
    return report


def without_malformed_jobs(state: WorkerState) -> WorkerState:
    return replace(state, holds=tuple(held for held in state.holds if not problem_of(held)))
