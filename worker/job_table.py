"""All jobs of one worker: told of orders and scans, answers with reports."""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from particle_filter.sensor_model import SensorModel
from particle_filter.settings import FilterSettings
from protocol.step_reset_detector import StepResetDetector, is_huge_jump
from protocol.steps import Scan
from protocol.work import Assignment, Report, WorkOrder
from worker.jobs import RunningJob, Searching, Tracking, running
from worker.recent_reports import RecentReports
from worker.search_queue import SearchQueue

RECENT_SCANS = 64
"""Scans kept at hand for jobs that begin a little behind."""
RECENT_SCANS_OF_WAITING = 512
"""While a job waits for older ones: more than come before the bridge is given up."""


@dataclass(frozen=True)
class MissingScans:
    """Steps that a job needs and that only the bridge's history has."""

    first: int
    last: int | None
    """None: up to the newest, for this worker has seen no scan yet."""


class JobTable:
    """The jobs of one worker, each with the last step it has done."""

    def __init__(self, sender: str) -> None:
        self._sender = sender
        self._jobs: dict[str, RunningJob] = {}
        self._recent: deque[Scan] = deque()
        self._reports = RecentReports()
        self._step_resets = StepResetDetector()
        self._waiting: set[str] = set()
        """Jobs that take no scan before those that they miss have come."""
        self._searches = SearchQueue()

    def summary(self) -> tuple[tuple[str, int, int], ...]:
        """(job id, epoch, last step done) of each job."""
        return tuple(
            (job_id, job.assignment.epoch, job.step) for job_id, job in sorted(self._jobs.items())
        )

    def is_news(self, order: WorkOrder) -> bool:
        """Whether an order changes anything; one that does not is a question after a lost link."""
        held = {(job_id, job.assignment.epoch) for job_id, job in self._jobs.items()}
        resized = (self._tracked(job_id) for job_id, _, _ in order.resize)
        sizes = [job.size for job in resized if job is not None]
        return (
            bool(order.begin)
            or set(order.keep) != held
            or sizes != [(particles, first_step) for _, particles, first_step in order.resize]
        )

    def holds(self) -> tuple[Assignment, ...]:
        """The jobs, each from where another worker could carry on."""
        return tuple(job.handed_on() for _, job in sorted(self._jobs.items()))

    def reports_since(self, step: int) -> list[Report]:
        """What the jobs have reported of later steps; of searches also some before."""
        return self._reports.since(step)

    def follow(self, order: WorkOrder, model: SensorModel, settings: FilterSettings) -> None:
        """Begin and end jobs, so that just those of the order are left.

        Raises:
            ValueError: a job's particles are no cloud; no job is changed then.
        """
        kept = {
            job_id: job
            for job_id, job in self._jobs.items()
            if (job_id, job.assignment.epoch) in order.keep
        }
        begun = {
            assignment.job_id: self._same(assignment.job_id, assignment.epoch)
            or running(
                assignment,
                model,
                settings,
                sender=self._sender,
                snapshot_every_steps=order.snapshot_every_steps,
            )
            for assignment in order.begin
        }
        self._jobs = kept | begun
        for job_id, particles, first_step in order.resize:
            if (job := self._tracked(job_id)) is not None:
                job.size = particles, first_step
        self._searches.keep_only(self._jobs.values())
        self._reports.keep_only(self._jobs)

    def use(self, model: SensorModel, settings: FilterSettings) -> None:
        """Let all jobs go on with other numbers."""
        for job in self._jobs.values():
            job.use(model, settings)

    def _tracked(self, job_id: str) -> Tracking | None:
        job = self._jobs.get(job_id)
        return job if isinstance(job, Tracking) else None

    def _same(self, job_id: str, epoch: int) -> RunningJob | None:
        """The job if it has begun already: an order may come twice."""
        job = self._jobs.get(job_id)
        return job if job is not None and job.assignment.epoch == epoch else None

    def missing(self) -> MissingScans | None:
        """The steps that must be fetched before the jobs can catch up with the newest scan."""
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
        """Let jobs that could use these steps take none before `catch_up`; None: none waits."""
        self._waiting = {
            job_id
            for job_id, job in self._jobs.items()
            if missing and (missing.last is None or job.step < missing.last)
        }

    def lost_before(self, scan: Scan) -> MissingScans | None:
        """The steps just before `scan` whose scans never came, where a job could use them."""
        newest = self._recent[-1] if self._recent else scan
        if not self._jobs or scan.step <= newest.step + 1 or is_huge_jump(scan, newest):
            return None
        return MissingScans(newest.step + 1, scan.step - 1)

    def said_last(self) -> list[Report]:
        """The reports on the newest step once more, for one who may have lost them."""
        newest = self._recent[-1].step if self._recent else -1
        return self._reports.of_step(newest)

    def catch_up(self, history: Iterable[Scan] = ()) -> list[Report]:
        """Bring all jobs but those that wait up to the newest scan, with scans of the past."""
        known = {scan.step: scan for scan in (*history, *self._recent)}
        return [report for step in sorted(known) for report in self._advance(known[step])]

    def on_scan(self, scan: Scan) -> list[Report]:
        """One scan: every job that has not done its step, and does not wait, does it.

        The newest scan once more is a question: its reports seem to be lost, and go out again.
        """
        newest = self._recent[-1] if self._recent else None
        if newest is not None and (scan.step < newest.step or is_huge_jump(scan, newest)):
            if not self._step_resets.starts_anew(scan, newest):
                return []
            self._recent.clear()
            newest = None
        self._step_resets.goes_on()
        if newest is None or scan.step > newest.step:
            self._keep(scan)
            return self._advance(scan)
        return self.said_last() + self._advance(scan)

    def _keep(self, scan: Scan) -> None:
        self._recent.append(scan)
        while len(self._recent) > (RECENT_SCANS_OF_WAITING if self._waiting else RECENT_SCANS):
            self._recent.popleft()

    @property
    def searches(self) -> bool:
        """Whether a search has something to do, with `search_on`."""
        return bool(self._searches)

    def search_on(self) -> list[Report]:
        """Let a search compute for some milliseconds; its report, if it has finished a step."""
        report = self._searches.work()
        if report is None:
            return []
        self._reports.add(report)
        return [report]

    def _advance(self, scan: Scan) -> list[Report]:
        """Tracked clusters take the scan at once, searches when there is time."""
        reports = []
        for job_id, job in sorted(self._jobs.items()):
            if scan.step <= job.step or job_id in self._waiting:
                continue
            if isinstance(job, Searching):
                self._searches.add(job, scan)
            else:
                reports.append(job.advance(scan))
        for report in reports:
            self._reports.add(report)
        return reports
