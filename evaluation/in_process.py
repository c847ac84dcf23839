"""Cluster-MCL in one process, without Zenoh: the same objects, called instead of messaged.

With the same seed and scans it believes, step by step, exactly what the processes believe that
meet over Zenoh: `clustermcl evaluate` runs it, and a test compares the two.
"""

from collections.abc import Iterable, Iterator

from coordinator.belief.ensemble import Ensemble
from coordinator.belief.outcome import Outcome
from particle_filter.sensor_model import SensorModel
from particle_filter.settings import FilterSettings
from protocol.steps import Scan
from protocol.work import Assignment
from worker.jobs import RunningJob, running


def outcomes(
    scans: Iterable[Scan], model: SensorModel, settings: FilterSettings
) -> Iterator[tuple[Scan, Outcome]]:
    """The belief after every step.

    Args:
        scans: gated steps, in their order.
        model: the map as the sensors see it.
        settings: the filter's numbers.
    """
    ensemble = Ensemble(settings)
    jobs: dict[str, RunningJob] = {}

    def begin(job_id: str, assignment: Assignment) -> None:
        jobs[job_id] = running(assignment, model, settings, sender="in-process")

    first = True
    for scan in scans:
        if first:
            for job_id, job in ensemble.begin_at(scan.step).items():
                begin(job_id, Assignment(job_id=job_id, epoch=0, job=job))
            first = False
        reports = [jobs[job_id].advance(scan) for job_id in sorted(jobs)]
        outcome = ensemble.advance(scan.step, reports)
        for job_id in outcome.end:
            del jobs[job_id]
        for job_id, job in outcome.begin.items():
            begin(job_id, Assignment(job_id=job_id, epoch=0, job=job))
        yield scan, outcome
