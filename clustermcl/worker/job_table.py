"""The table of one worker's jobs, which follows orders, takes scans and returns reports."""

from collections import deque
from collections.abc import Iterable
from itertools import chain

import msgspec
from msgspec.structs import replace

from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.filter.settings import FilterSettings
from clustermcl.jobs.jobs import RunningJob, Searching, Tracking, running
from clustermcl.jobs.scan_arrays import ScanArrays
from clustermcl.protocol.step_reset_detector import StepResetDetector, is_huge_jump
from clustermcl.protocol.steps import KEPT_STEPS, Scan
from clustermcl.protocol.work import Assignment, Report, SearchReport, TrackReport, WorkOrder
from clustermcl.worker.search_queue import SearchQueue

RECENT_SCANS = 64
"""Number of scans kept for a job that begins a few steps behind."""
RECENT_SCANS_OF_WAITING = 512
"""Number of scans kept while a job waits for older ones, until the query for these times out."""
KEPT_SEARCH_STEPS = 16
"""Number of reports kept for a search; a report has up to half a megabyte. A new coordinator needs
a step that all shards have reported, and shards are seldom further apart."""


class MissingScans(msgspec.Struct, frozen=True):
    """Steps that a job needs, to be fetched from the bridge's history."""

    first: int
    last: int | None
    """The last missing step; None: the newest one, as this worker has received no scan yet."""


class RecentReports:
    """The reports of each job for the steps that the bridge keeps; the newest has particles."""

    def __init__(self) -> None:
        self._of: dict[str, deque[Report]] = {}

    def add(self, report: Report) -> None:
        most = KEPT_SEARCH_STEPS if isinstance(report, SearchReport) else KEPT_STEPS
        kept = self._of.setdefault(report.job_id, deque(maxlen=most))
        if kept and isinstance(last := kept[-1], TrackReport) and last.snapshot is not None:
            kept[-1] = replace(last, snapshot=None)
        kept.append(report)

    def keep_only(self, job_ids: Iterable[str]) -> None:
        self._of = {job_id: self._of[job_id] for job_id in job_ids if job_id in self._of}

    def since(self, step: int, *, searches: bool = False) -> list[Report]:
        """Return the reports of later steps, with `searches` also all of searches, by step."""
        found = [
            report
            for report in chain.from_iterable(self._of.values())
            if report.step > step or (searches and isinstance(report, SearchReport))
        ]
        return sorted(found, key=lambda report: (report.step, report.job_id))


class JobTable:
    """The jobs of one worker, each with the last step it has done."""

    def __init__(self, sender: str) -> None:
        self._sender = sender
        self._jobs: dict[str, RunningJob] = {}
        self._arrays = ScanArrays()
        self._recent: deque[Scan] = deque()
        self.reports = RecentReports()
        self._step_resets = StepResetDetector()
        self._waiting: set[str] = set()
        """Jobs that take no scan until their missing scans arrive."""
        self._searches = SearchQueue()

    def summary(self) -> tuple[tuple[str, int, int], ...]:
        """Return (job id, epoch, last step done) of each job."""
        return tuple(
            (job_id, job.assignment.epoch, job.step) for job_id, job in sorted(self._jobs.items())
        )

    def holds(self) -> tuple[Assignment, ...]:
        """Return the jobs in a form that another worker can continue."""
        return tuple(job.handed_on() for _, job in sorted(self._jobs.items()))

    def follow(self, order: WorkOrder, model: SensorModel, settings: FilterSettings) -> None:
        """Begin and end jobs to match an order.

        Raises:
            ValueError: the map has no free cell to search; no job is changed.
        """
        wanted = {*order.keep, *((given.job_id, given.epoch) for given in order.begin)}
        kept = {i: job for i, job in self._jobs.items() if (i, job.assignment.epoch) in wanted}
        begun = {
            given.job_id: running(
                given,
                model,
                settings,
                sender=self._sender,
                snapshot_every_steps=order.snapshot_every_steps,
                arrays=self._arrays,
            )
            for given in order.begin
            if given.job_id not in kept
        }
        self._jobs = kept | begun
        if not self._jobs:
            self._recent.clear()  # old scans, once there is a job again
        for job_id, particles, first_step in order.resize:
            if isinstance(job := self._jobs.get(job_id), Tracking):
                job.size = particles, first_step
        self._searches.keep_only(self._jobs.values())
        self.reports.keep_only(self._jobs)

    def use(self, model: SensorModel, settings: FilterSettings) -> None:
        for job in self._jobs.values():
            job.use(model, settings)

    def missing(self) -> MissingScans | None:
        """Return the steps to fetch so that the jobs can catch up with the newest scan."""
        if not self._jobs:
            return None
        done = min(job.step for job in self._jobs.values())
        if not self._recent:
            return MissingScans(done + 1, None)
        missing = None
        for scan in self._recent:
            if scan.step > done + 1:
                missing = MissingScans(missing.first if missing else done + 1, scan.step - 1)
            done = max(done, scan.step)
        return missing

    def wait_for(self, missing: MissingScans | None) -> None:
        """Pause the jobs that need these steps; None: pause no job."""
        self._waiting = {
            job_id
            for job_id, job in self._jobs.items()
            if missing and (missing.last is None or job.step < missing.last)
        }

    def lost_before(self, scan: Scan) -> MissingScans | None:
        """Return the missing steps before `scan`; None: no step is missing, or no job needs one."""
        newest = self._recent[-1] if self._recent else scan
        if not self._jobs or scan.step <= newest.step + 1 or is_huge_jump(scan, newest):
            return None
        return MissingScans(newest.step + 1, scan.step - 1)

    def scan_of(self, step: int) -> Scan | None:
        """Return the scan of a step; None: it is no longer stored, or never arrived."""
        return next((scan for scan in self._recent if scan.step == step), None)

    def rewind(self, earlier: Iterable[Scan]) -> list[Scan]:
        """Forget all scans; return them with others, by step, so that `on_scan` takes them again.

        Then each job takes those that it has not taken yet.
        """
        known = {scan.step: scan for scan in (*earlier, *self._recent)}
        self._recent.clear()
        return [known[step] for step in sorted(known)]

    def on_scan(self, scan: Scan) -> list[Report]:
        """Advance every job that has not done this step and does not wait; return the reports.

        An older scan is ignored, unless the steps have begun again. A repeated one repeats its
        reports.
        """
        newest = self._recent[-1] if self._recent else None
        if newest is not None and (scan.step < newest.step or is_huge_jump(scan, newest)):
            if not self._step_resets.on_other_scan(scan, newest):
                return []
            self._recent.clear()
            newest = None
        self._step_resets.reset()
        if newest is not None and scan.step == newest.step:
            return self.reports.since(scan.step - 1) + self._advance(scan)
        self._recent.append(scan)
        while len(self._recent) > (RECENT_SCANS_OF_WAITING if self._waiting else RECENT_SCANS):
            self._recent.popleft()
        return self._advance(scan)

    @property
    def searches(self) -> bool:
        return bool(self._searches)

    def search_on(self) -> list[Report]:
        """Compute one slice of a search; return its report if it has finished a step."""
        report = self._searches.work()
        if report is None:
            return []
        self.reports.add(report)
        return [report]

    def _advance(self, scan: Scan) -> list[Report]:
        """Advance all jobs but searches, for which the scan is queued."""
        reports = []
        for job_id, job in sorted(self._jobs.items()):
            if scan.step <= job.step or job_id in self._waiting:
                continue
            if isinstance(job, Searching):
                self._searches.add(job, scan)
            else:
                reports.append(job.advance(scan))
        for report in reports:
            self.reports.add(report)
        return reports
