"""What the jobs have reported of late, for a coordinator that was not there to hear it."""

from collections import deque
from collections.abc import Iterable

import msgspec

from protocol.work import Report, SearchReport, TrackReport

KEPT_STEPS = 300
"""As many as the bridge keeps scans of: older steps cannot be applied any more."""
KEPT_SEARCH_STEPS = 16
"""A search tells all anew each step, and its reports are large: half a megabyte with all places.
Shards need one step in common, and are seldom further apart."""


class RecentReports:
    """The last reports of each job; particles only in the very last."""

    def __init__(self) -> None:
        self._of: dict[str, deque[Report]] = {}

    def add(self, report: Report) -> None:
        """Remember a report."""
        kept = self._of.get(report.job_id)
        if kept is None:
            is_search = isinstance(report, SearchReport)
            kept = deque(maxlen=KEPT_SEARCH_STEPS if is_search else KEPT_STEPS)
            self._of[report.job_id] = kept
        if kept and isinstance(last := kept[-1], TrackReport) and last.snapshot is not None:
            kept[-1] = msgspec.structs.replace(last, snapshot=None)
        kept.append(report)

    def keep_only(self, job_ids: Iterable[str]) -> None:
        """Forget what other jobs have reported."""
        self._of = {job_id: self._of[job_id] for job_id in job_ids if job_id in self._of}

    def of_step(self, step: int) -> list[Report]:
        """The jobs' last reports, where they are of this step."""
        return [kept[-1] for kept in self._of.values() if kept[-1].step == step]

    def since(self, step: int) -> list[Report]:
        """Reports of later steps, in their order; all that are kept of a search."""
        return sorted(
            (
                report
                for kept in self._of.values()
                for report in kept
                if report.step > step or isinstance(report, SearchReport)
            ),
            key=lambda report: (report.step, report.job_id),
        )
