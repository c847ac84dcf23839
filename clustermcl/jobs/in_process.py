"""Cluster-MCL in one process, without Zenoh: method calls in place of messages.

With the same seed and scans its beliefs are exactly those of the processes that communicate over
Zenoh; a test compares the two. `clustermcl evaluate` and the library use it.
"""

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from clustermcl.belief.ensemble import Ensemble
from clustermcl.belief.outcome import Outcome
from clustermcl.filter.laser.sensor_model import SensorModel, computed_model
from clustermcl.filter.poses import between
from clustermcl.filter.settings import FilterSettings, filter_with
from clustermcl.jobs.jobs import RunningJob, Tracking, running
from clustermcl.jobs.scan_arrays import ScanArrays
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.work import Assignment, Job, Report


def outcomes(
    scans: Iterable[Scan], model: SensorModel, settings: FilterSettings
) -> Iterator[tuple[Scan, Outcome]]:
    """Yield the belief after every step; settings in a scan override those at the start."""
    process = InProcess(model, settings)
    for scan in scans:
        yield scan, process.advance(scan)


class InProcess:
    """The belief and all its jobs; `reports` are those of the last step."""

    def __init__(
        self, model: SensorModel, settings: FilterSettings, snapshot_every_steps: int = 0
    ) -> None:
        self._model, self._settings = model, settings
        self._snapshot_every, self.reports = snapshot_every_steps, list[Report]()
        self._started = settings
        self.ensemble = Ensemble.of(settings)
        self.jobs: dict[str, RunningJob] = {}
        self._arrays = ScanArrays()
        self.applied: Scan | None = None
        """The scan of the last step; None before the first."""

    def advance(self, scan: Scan) -> Outcome:
        """Apply a step; then begin and end jobs as the belief requires."""
        self._use(filter_with(self._started, scan.settings))
        if not self.ensemble.searches:
            self._begin(self.ensemble.begin_at(scan.step))
        self.reports = [self.jobs[job_id].advance(scan) for job_id in sorted(self.jobs)]
        before, self.applied = self.applied, scan
        after = np.array(scan.odom_from_robot)
        moved = None if before is None else between(np.array(before.odom_from_robot), after)
        outcome = self.ensemble.advance(scan.step, self.reports, moved, scan)
        self.carry_out(outcome)
        return outcome

    def _use(self, settings: FilterSettings) -> None:
        if settings == self._settings:
            return
        if settings.sensor != self._settings.sensor:
            self._model = computed_model(self._model.grid, settings.sensor)
        self._settings = settings
        self.ensemble.use(settings)
        for job in self.jobs.values():
            job.use(self._model, settings)

    def carry_out(self, outcome: Outcome) -> None:
        """End and begin the jobs of a step or of a command."""
        for job_id in outcome.end:
            del self.jobs[job_id]
        self._begin(outcome.begin)
        for job_id, size in outcome.resize.items():
            job = self.jobs[job_id]
            assert isinstance(job, Tracking)  # only clusters have a number of particles
            job.size = size

    def _begin(self, jobs: Mapping[str, Job]) -> None:
        for job_id, job in jobs.items():
            self.jobs[job_id] = running(
                Assignment(job_id=job_id, epoch=0, job=job),
                self._model,
                self._settings,
                sender="in-process",
                snapshot_every_steps=self._snapshot_every,
                arrays=self._arrays,
            )
