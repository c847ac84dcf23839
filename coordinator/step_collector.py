"""Steps in their order: when all reports are in, or none can be waited for any longer."""

from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import msgspec

from coordinator.jobs import HAND_OVER_NS
from coordinator.part import Count, Part
from particle_filter.settings import FilterSettings
from process_runtime.settings import CoordinatorSettings
from protocol.arrays import ArrayBlob
from protocol.errors import MalformedMessageError
from protocol.steps import Scan
from protocol.work import Report, SearchReport, TrackReport

TOO_LARGE = "more than its job allows"


def has_too_large_snapshot(report: Report, settings: FilterSettings) -> bool:
    """Return whether a snapshot holds more particles than a cluster may have."""
    snapshot = report.snapshot if isinstance(report, TrackReport) else None
    return snapshot is not None and snapshot.log_weights.shape[0] > settings.cluster.particles


def check_places(report: Report, settings: FilterSettings) -> None:
    """Check the number of places in a report, and of their particles.

    Raises:
        MalformedMessageError: the report has more than the settings allow.
    """
    rules = settings.search
    match report:
        case SearchReport(places=found):
            places, particles = len(found), found.particles.shape[0]
            most = rules.places
            most_particles = rules.places_with_particles * rules.hand_over_particles + rules.places
        case TrackReport(parts=parts):
            places, particles = len(parts), sum(p.sample.log_weights.shape[0] for p in parts)
            most = int(1.0 / settings.cluster.split_min_share) + 1
            most_particles = most * rules.hand_over_particles
        case _:
            return
    if places > most or particles > most_particles:
        raise MalformedMessageError(
            expected=type(report).__name__,
            problem=f"{places} places and {particles} particles of them, "
            f"at most {most} and {most_particles} by the settings",
            kind=TOO_LARGE,
        )


FETCH_NS = 500_000_000
"""A step waits this long for an earlier scan, which is requested from the bridge [ns]."""
REPORTS_AHEAD = 300
"""Reports of steps further above the newest scan are refused; it is the length of the history."""
KEPT_AHEAD = 1_000
"""Reports of at most this number of different steps are kept."""
BULKY_REPORTS = 16
"""Waiting reports of one job that contain places: the number of steps that a search pools."""


class OpenStep(Part):
    """A step that has not been applied yet."""

    scan: Scan | None = None
    arrived_ns: int = 0
    reports: dict[str, Report] = {}


def is_bulky(report: Report) -> bool:
    """Return whether a report contains places with particles."""
    return isinstance(report, SearchReport) or (
        isinstance(report, TrackReport) and len(report.parts) > 0
    )


def without_snapshot(report: Report) -> Report:
    """Return the report without particles, which are stored once, with the job."""
    if isinstance(report, TrackReport) and report.snapshot is not None:
        return msgspec.structs.replace(report, snapshot=None)
    return report


@dataclass(frozen=True)
class ReadyStep:
    """A step that can be applied."""

    scan: Scan
    before: Scan | None
    """The scan of the step that was applied last."""
    reports: tuple[Report, ...]
    arrived_ns: int = 0
    """When the scan came, by the clock of all events."""


class StepCollector(Part):
    """Collects scans and reports; gives out steps strictly in order."""

    local: ClassVar = frozenset({"settings", "open_steps", "late", "base"})
    settings: CoordinatorSettings = CoordinatorSettings()
    open_steps: dict[int, OpenStep] = {}
    late: list[SearchReport] = []
    """Reports of searches on steps that are over, for the next step."""
    base: int | None = None
    """The step after which the first one should be; None: any may be the first."""
    applied: Scan | None = None
    """The scan of the last applied step, without its beams; None: no step of this count is over."""
    steps_lost: Count = 0
    """Steps left out because their scans never came."""

    def begin_after(self, step: int) -> None:
        """Start after `step`; discard earlier steps."""
        if self.applied is None:
            self.base = step
            self.open_steps = {one: opened for one, opened in self.open_steps.items() if one > step}

    def restart(self, before: int, applied: Scan | None = None) -> None:
        """Drop all open steps, and count further steps from `before` + 1.

        Args:
            before: number of the step before the next one.
            applied: scan to use as that of step `before`; None: no place is known from it.
        """
        self.open_steps.clear()
        self.late.clear()
        self.applied, self.base = applied and _without_beams(applied), before

    @property
    def oldest_scan(self) -> Scan | None:
        """The oldest scan that waits to be applied."""
        waiting = [opened.scan for opened in self.open_steps.values() if opened.scan]
        return min(waiting, key=lambda scan: scan.step, default=None)

    @property
    def oldest_reports(self) -> Mapping[str, Report] | None:
        """Reports of the oldest step that waits to be applied, by job; None: no step waits."""
        step = min((step for step, opened in self.open_steps.items() if opened.scan), default=None)
        return None if step is None else self.open_steps[step].reports

    @property
    def newest_scan(self) -> Scan | None:
        """The newest scan that waits to be applied."""
        waiting = [opened.scan for opened in self.open_steps.values() if opened.scan]
        return max(waiting, key=lambda scan: scan.step, default=None)

    def on_scan(self, scan: Scan, now_ns: int) -> bool:
        """Take a scan; return False if it is old or known."""
        if self.before is not None and scan.step <= self.before:
            return False
        opened = self.open_steps.setdefault(scan.step, OpenStep())
        if opened.scan is not None:
            return False
        opened.scan, opened.arrived_ns = scan, now_ns
        return True

    def lost_before(self, scan: Scan) -> tuple[int, int] | None:
        """Return the first and last of the steps lost just before `scan`; None: none is lost."""
        arrived = (step for step, opened in self.open_steps.items() if opened.scan)
        newest = max((step for step in arrived if step < scan.step), default=self.before)
        if newest is None or newest + 1 == scan.step:
            return None
        return newest + 1, scan.step - 1

    def restart_deadlines(self, now_ns: int) -> None:
        """Restart the deadlines: no report could arrive while the link was lost."""
        for opened in self.open_steps.values():
            opened.arrived_ns = now_ns

    def has_room_for(self, report: Report, *, is_recovered: bool = False) -> bool:
        """Return whether a report may wait for its step.

        Args:
            report: of a job's present worker.
            is_recovered: a worker repeats it after a take-over, before the scans are fetched.
        """
        if self._is_over(report.step):
            return True
        newest = self._newest_scan_step
        is_far = newest is not None and report.step > newest + REPORTS_AHEAD
        if report.step not in self.open_steps and len(self.open_steps) > KEPT_AHEAD:
            return False
        if is_far and not is_recovered:
            return False
        return not is_bulky(report) or self._bulky_of(report) < BULKY_REPORTS

    @property
    def _newest_scan_step(self) -> int | None:
        known = [step for step, opened in self.open_steps.items() if opened.scan]
        return max(known, default=self.before)

    def _bulky_of(self, report: Report) -> int:
        """Return the number of bulky reports of this job that wait for other steps."""
        return sum(
            is_bulky(waiting)
            for step, opened in self.open_steps.items()
            if step != report.step and (waiting := opened.reports.get(report.job_id)) is not None
        )

    def on_report(self, report: Report) -> bool:
        """Store a report; return False if its step is over and the report adds nothing."""
        if not self._is_over(report.step):
            opened = self.open_steps.setdefault(report.step, OpenStep())
            opened.reports[report.job_id] = without_snapshot(report)
            return True
        if not isinstance(report, SearchReport):
            return False
        self.late.append(report)  # it may arrive a step later
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
        unhurried: Container[str] = (),
    ) -> ReadyStep | None:
        """Return the next step, if it is complete or its deadline has passed.

        Args:
            expected: ids of the jobs whose reports the step needs.
            placed_ns: returns the time at which a job was given to its worker [ns]; a step waits
                longer for a new job.
            now_ns: time by the same clock as in `on_scan` [ns].
            unhurried: ids of jobs that may report a step later.
        """
        step = min((s for s, opened in self.open_steps.items() if opened.scan), default=None)
        if step is None:
            return None
        opened = self.open_steps[step]
        follows = self.before is None or step == self.before + 1
        if not follows and now_ns < opened.arrived_ns + FETCH_NS:
            return None
        missing = [
            job_id
            for job_id in expected
            if job_id not in opened.reports
            and not (job_id in unhurried and self._is_late_for_searches(opened, now_ns))
        ]
        if missing and now_ns < self._deadline(opened, missing, placed_ns):
            return None
        return self._close(step)

    @property
    def before(self) -> int | None:
        """The step after which the next one should be; None: any may be the first."""
        return self.base if self.applied is None else self.applied.step

    @property
    def waits_for_no_search(self) -> bool:
        """Whether the next step is decided as soon as all but searches have reported."""
        oldest = self.oldest_scan
        return oldest is not None and not oldest.lockstep and self.settings.search_deadline_s == 0.0

    def _is_late_for_searches(self, opened: OpenStep, now_ns: int) -> bool:
        """Return whether the search deadline of a step has passed; a lockstep step has none."""
        wait_ns = int(self.settings.search_deadline_s * 1e9)
        lockstep = opened.scan is not None and opened.scan.lockstep
        return not lockstep and now_ns >= opened.arrived_ns + wait_ns

    def _deadline(
        self, opened: OpenStep, missing: list[str], placed_ns: Callable[[str], int]
    ) -> int:
        lockstep = opened.scan is not None and opened.scan.lockstep
        settings = self.settings
        wait_s = settings.lockstep_deadline_s if lockstep else settings.step_deadline_s
        newest = max(placed_ns(job_id) for job_id in missing)
        return max(opened.arrived_ns + int(wait_s * 1e9), newest + HAND_OVER_NS if newest else 0)

    def _close(self, step: int) -> ReadyStep:
        opened = self.open_steps.pop(step)
        assert opened.scan is not None  # `ready` chose a step that has one
        for older in [other for other in self.open_steps if other < step]:
            del self.open_steps[older]
        lost = 0 if self.before is None else step - self.before - 1
        before, self.applied = self.applied, _without_beams(opened.scan)
        self.steps_lost += lost
        late, self.late = self.late, []
        reports = (*late, *opened.reports.values())
        return ReadyStep(opened.scan, before, reports, opened.arrived_ns)

    def resume(self, handed_on: "StepCollector") -> None:
        """Continue from another coordinator's state; waiting scans of later steps stay.

        Waiting reports are dropped: the other coordinator's jobs may have the same ids.
        """
        self.applied, self.steps_lost = handed_on.applied, handed_on.steps_lost
        self.late.clear()
        over = -1 if self.applied is None else self.applied.step
        self.open_steps = {
            step: OpenStep(opened.scan, opened.arrived_ns)
            for step, opened in self.open_steps.items()
            if step > over and opened.scan
        }


def _without_beams(scan: Scan) -> Scan:
    empty = ArrayBlob(dtype="float32", shape=(0,), data=b"")
    return msgspec.structs.replace(scan, ranges=empty, others=())
