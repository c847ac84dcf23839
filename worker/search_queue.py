"""What searches have still to do: in slices, for tracked clusters must not wait for them."""

from collections import deque
from collections.abc import Iterable

from particle_filter.slices import Slices
from protocol.steps import Scan
from protocol.work import SearchReport
from worker.jobs import RunningJob, Searching

KEPT_SCANS = 64
"""Of one search; one that falls further behind leaves out the oldest of them."""


class SearchQueue:
    """The scans that searches have not taken yet, oldest first.

    A search takes its scans in their order, a slice at a time: what it finds does not depend on
    how much time there was in between, unless it is too slow for its scans altogether.
    """

    def __init__(self) -> None:
        self._left: dict[int, tuple[Searching, deque[Scan]]] = {}
        self._slices: Slices[SearchReport] | None = None
        self._searching: Searching | None = None
        """Whose slices they are."""

    def __bool__(self) -> bool:
        return self._slices is not None or any(scans for _, scans in self._left.values())

    def add(self, search: Searching, scan: Scan) -> None:
        """One more scan for a search; the same or an older one is left out."""
        scans = self._left.setdefault(id(search), (search, deque(maxlen=KEPT_SCANS)))[1]
        if not scans or scan.step > scans[-1].step:
            scans.append(scan)

    def keep_only(self, jobs: Iterable[RunningJob]) -> None:
        """Forget what searches that have ended had to do."""
        kept = {id(job) for job in jobs}
        self._left = {key: left for key, left in self._left.items() if key in kept}
        if self._searching is not None and id(self._searching) not in kept:
            self._slices = self._searching = None

    def work(self) -> SearchReport | None:
        """Compute one slice; the report of a step that it finishes."""
        if self._slices is None:
            waiting = [left for left in self._left.values() if left[1]]
            if not waiting:
                return None
            self._searching, scans = min(waiting, key=lambda left: left[1][0].step)
            self._slices = self._searching.slices(scans.popleft())
        try:
            next(self._slices)
        except StopIteration as done:
            self._slices = self._searching = None
            report: SearchReport = done.value
            return report
        return None
