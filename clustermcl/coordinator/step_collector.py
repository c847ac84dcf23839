"""Releases steps in order, each once its reports have arrived or its deadline has passed."""

from collections.abc import Callable, Container, Iterable
from typing import ClassVar

import msgspec
from msgspec.structs import replace

from clustermcl.belief.part import Count, Part
from clustermcl.coordinator.jobs import HAND_OVER_NS
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.work import Report, SearchReport, TrackReport
from clustermcl.runtime.settings import CoordinatorSettings

FETCH_NS, UNANSWERED_NS = 500_000_000, 1_500_000_000
"""A step waits this time for an earlier scan, which is requested from the bridge [ns]; the longer
one if the bridge has not answered yet, as on a busy machine."""
REPORTS_AHEAD = 300
"""Reports of a step further above the newest scan are refused; the bridge keeps fewer steps."""
KEPT_AHEAD = 1_000
"""Largest number of steps whose reports are kept."""
BULKY_REPORTS = 16
"""Largest number of bulky reports kept for a job: a search pools this number of steps."""


class OpenStep(Part):
    """A step that has not been applied yet."""

    scan: Scan | None = None
    arrived_ns: int = 0
    reports: dict[str, Report] = {}
    early: dict[str, int] = {}
    """When those reports arrived that came before the scan [ns], by job."""


class ReadyStep(msgspec.Struct, frozen=True):
    """A step that can be applied."""

    scan: Scan
    before: Scan | None
    reports: tuple[Report, ...]
    arrived_ns: int = 0


class StepCollector(Part):
    """Collects scans and reports of steps that are not applied yet."""

    local: ClassVar = frozenset(
        {"settings", "open_steps", "late", "base", "is_fetching", "link_back_ns"}
    )
    settings: CoordinatorSettings = CoordinatorSettings()
    open_steps: dict[int, OpenStep] = {}
    late: list[SearchReport] = []
    """Searches' reports on applied steps, for the next step."""
    base: int | None = None
    """Number before the first step; None: any step may be the first."""
    is_fetching: bool = False
    """Whether the bridge has not answered a request for scans yet."""
    link_back_ns: int = -UNANSWERED_NS
    """When the link came back last [ns]; workers then repeat reports, and scans are fetched."""
    applied: Scan | None = None
    """The scan of the last applied step, without its beams; None: no step was applied."""
    steps_lost: Count = 0
    """Number of steps whose scans never arrived."""

    def begin_after(self, step: int) -> None:
        """Start after `step` and discard earlier steps, unless a step was applied."""
        if self.applied is None:
            self.base = step
            self.open_steps = {one: opened for one, opened in self.open_steps.items() if one > step}

    def restart(self, before: int, applied: Scan | None = None) -> None:
        """Drop all open steps; continue after step `before`, whose scan is `applied`, if any."""
        self.open_steps.clear()
        self.late.clear()
        self.applied, self.base = applied and _without_beams(applied), before

    @property
    def _waiting(self) -> list[Scan]:
        """The scans that are not applied, oldest first."""
        scans = [opened.scan for opened in self.open_steps.values() if opened.scan]
        return sorted(scans, key=lambda scan: scan.step)

    @property
    def oldest_scan(self) -> Scan | None:
        return next(iter(self._waiting), None)

    @property
    def newest_scan(self) -> Scan | None:
        return next(reversed(self._waiting), None)

    def on_scan(self, scan: Scan, now_ns: int) -> bool:
        """Store a scan; return False if it is old or known."""
        if self.before is not None and scan.step <= self.before:
            return False
        opened = self.open_steps.setdefault(scan.step, OpenStep())
        if opened.scan is not None:
            return False
        opened.scan, opened.arrived_ns = scan, now_ns
        # A forged report on a step to come would make the step complete before the true one.
        for job_id, early_ns in opened.early.items():
            if now_ns - early_ns > UNANSWERED_NS:
                del opened.reports[job_id]
        opened.early = {}
        return True

    def lost_before(self, scan: Scan) -> tuple[int, int] | None:
        """Return the first and last of the steps lost just before `scan`; None: no step is lost."""
        arrived = (step for step, opened in self.open_steps.items() if opened.scan)
        newest = max((step for step in arrived if step < scan.step), default=self.before)
        if newest is None or newest + 1 == scan.step:
            return None
        return newest + 1, scan.step - 1

    def restart_deadlines(self, now_ns: int) -> None:
        """Restart the deadlines: no report could arrive while the link was lost."""
        self.link_back_ns = now_ns
        for opened in self.open_steps.values():
            opened.arrived_ns = now_ns

    def has_room_for(self, report: Report) -> bool:
        """Return whether the report of a job's present worker may wait for its step."""
        if self._is_over(report.step):
            return True
        if report.step not in self.open_steps and len(self.open_steps) > KEPT_AHEAD:
            return False
        scan = self.newest_scan
        newest = scan.step if scan else self.before
        if newest is not None and report.step > newest + REPORTS_AHEAD:
            return False
        if not isinstance(report, SearchReport):
            return True
        others = (opened for step, opened in self.open_steps.items() if step != report.step)
        of_job = (opened.reports.get(report.job_id) for opened in others)
        return sum(isinstance(kept, SearchReport) for kept in of_job) < BULKY_REPORTS

    def on_report(self, report: Report, now_ns: int) -> bool:
        """Store a report of a job's present worker; return False if its step was applied."""
        if not self._is_over(report.step):
            opened = self.open_steps.setdefault(report.step, OpenStep())
            if isinstance(report, TrackReport):
                report = replace(report, snapshot=None)  # which is stored with the job
            opened.reports[report.job_id] = report
            if opened.scan is None and now_ns >= self.link_back_ns + UNANSWERED_NS:
                opened.early[report.job_id] = now_ns
            return True
        if not isinstance(report, SearchReport):
            return False
        self.late.append(report)  # the next step uses it
        of_job = [late for late in self.late if late.job_id == report.job_id]
        if len(of_job) > BULKY_REPORTS:
            self.late.remove(min(of_job, key=lambda late: late.step))
        return True

    def _is_over(self, step: int) -> bool:
        return self.applied is not None and step <= self.applied.step

    def ready(
        self,
        expected: Iterable[str],
        placed_ns: Callable[[str], int],
        now_ns: int,
        deferrable: Container[str] = (),
    ) -> ReadyStep | None:
        """Return the next step if it is complete or its deadline has passed, else None.

        A step needs the reports of the `expected` jobs; `deferrable` ones may report a step later.
        It waits longer for a new job; see `Jobs.placed_ns`.
        """
        scan, settings = self.oldest_scan, self.settings
        if scan is None:
            return None
        opened = self.open_steps[scan.step]
        waited_ns = now_ns - opened.arrived_ns
        follows = self.before is None or scan.step == self.before + 1
        if not follows and waited_ns < (UNANSWERED_NS if self.is_fetching else FETCH_NS):
            return None
        no_search = not scan.lockstep and waited_ns >= int(settings.search_deadline_s * 1e9)
        missing = [
            job_id
            for job_id in expected
            if job_id not in opened.reports and not (no_search and job_id in deferrable)
        ]
        if missing:
            wait_s = settings.lockstep_deadline_s if scan.lockstep else settings.step_deadline_s
            newest_ns = max(map(placed_ns, missing))
            is_new = newest_ns > 0 and now_ns < newest_ns + HAND_OVER_NS
            if is_new or waited_ns < int(wait_s * 1e9):
                return None
        self.open_steps = {s: other for s, other in self.open_steps.items() if s > scan.step}
        self.steps_lost += 0 if self.before is None else scan.step - self.before - 1
        before, self.applied = self.applied, _without_beams(scan)
        reports, self.late = (*self.late, *opened.reports.values()), []
        return ReadyStep(scan, before, reports, opened.arrived_ns)

    @property
    def before(self) -> int | None:
        """Number of the step before the next one; None: any step may be the first."""
        return self.base if self.applied is None else self.applied.step

    def resume(self, handed_on: "StepCollector") -> None:
        """Continue from another coordinator's state; keep scans of later steps."""
        self.applied, self.steps_lost = handed_on.applied, handed_on.steps_lost
        self.late.clear()  # as all reports: the other coordinator's jobs may have the same ids
        over = -1 if self.applied is None else self.applied.step
        self.open_steps = {
            step: OpenStep(opened.scan, opened.arrived_ns)
            for step, opened in self.open_steps.items()
            if step > over and opened.scan
        }


def _without_beams(scan: Scan) -> Scan:
    empty = ArrayBlob(dtype="float32", shape=(0,), data=b"")
    return replace(scan, ranges=empty, others=())
