"""Cluster-MCL in one process, without Zenoh: the same objects, called instead of messaged.

With the same seed and scans it believes, step by step, exactly what the processes believe that
meet over Zenoh: `clustermcl evaluate` runs it, and a test compares the two.
"""

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from coordinator.belief.ensemble import Ensemble
from coordinator.belief.outcome import Outcome
from particle_filter.arrays import Pose
from particle_filter.poses import between
from particle_filter.sensor_model import SensorModel
from particle_filter.sensor_models import computed_model
from particle_filter.settings import FilterSettings, filter_with
from protocol.steps import Scan
from protocol.work import Assignment, Job
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
    process = InProcess(model, settings)
    for scan in scans:
        yield scan, process.advance(scan)


class InProcess:
    """The belief and all its jobs; arguments as for `outcomes`."""

    def __init__(self, model: SensorModel, settings: FilterSettings) -> None:
        self._model, self._settings = model, settings
        self._started = settings
        self.ensemble = Ensemble(settings)
        self._jobs: dict[str, RunningJob] = {}
        self._odom_from_robot: Pose | None = None

    def advance(self, scan: Scan) -> Outcome:
        """What a step comes to; its jobs have begun and ended."""
        self._use(filter_with(self._started, scan.settings))
        if not self.ensemble.searches:
            self._begin(self.ensemble.begin_at(scan.step))
        reports = [self._jobs[job_id].advance(scan) for job_id in sorted(self._jobs)]
        before, after = self._odom_from_robot, np.array(scan.odom_from_robot)
        self._odom_from_robot = after
        moved = None if before is None else between(before, after)
        outcome = self.ensemble.advance(scan.step, reports, moved)
        self.carry_out(outcome)
        return outcome

    def _use(self, settings: FilterSettings) -> None:
        """Go by the settings that hold at a step."""
        if settings == self._settings:
            return
        if settings.sensor != self._settings.sensor:
            self._model = computed_model(self._model.grid, settings.sensor)
        self._settings = settings
        self.ensemble.use(settings)
        for job in self._jobs.values():
            job.use(self._model, settings)

    def carry_out(self, outcome: Outcome) -> None:
        """End and begin jobs, also as a command has it."""
        for job_id in outcome.end:
            del self._jobs[job_id]
        self._begin(outcome.begin)

    def _begin(self, jobs: Mapping[str, Job]) -> None:
        for job_id, job in jobs.items():
            assignment = Assignment(job_id=job_id, epoch=0, job=job)
            self._jobs[job_id] = running(
                assignment, self._model, self._settings, sender="in-process"
            )
