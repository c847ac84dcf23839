"""Order and timing of searches, which compute in slices between the steps of tracked clusters."""

from collections import deque
from collections.abc import Iterable

from clustermcl.filter.slices import Slices
from clustermcl.jobs.jobs import RunningJob, Searching
from clustermcl.protocol.steps import KEPT_STEPS, Scan
from clustermcl.protocol.work import SearchReport

LONGEST_NS = 100_000_000
"""Longest pause after the first undecided scan [ns]. A step that takes longer may itself wait for
a search, so searches must go on."""


class SearchPause:
    """Pauses searches while the tracked clusters of a step compute.

    Slices are not enough: clusters tracked by other processes need the same cores, and would get
    only an equal share among many searches.
    """

    def __init__(self) -> None:
        self._scanned_step = self._believed_step = -1
        self._since_ns = 0
        self._founded = False

    def on_scan(self, step: int, now_ns: int) -> None:
        if self._scanned_step <= self._believed_step:
            self._since_ns = now_ns
        self._scanned_step = step

    def on_checkpoint(self, step: int, *, founded: bool) -> None:
        """Note the last decided step; a belief that never had clusters waits for searches."""
        self._believed_step, self._founded = step, founded

    def left_ns(self, now_ns: int) -> int:
        """Return the longest time that searches still pause [ns]; 0: no pause."""
        if not self._founded or self._scanned_step <= self._believed_step:
            return 0
        return max(self._since_ns + LONGEST_NS - now_ns, 0)


class SearchQueue:
    """The scans that searches have not taken yet, oldest first.

    A search takes its scans in order, a slice at a time. The time between slices changes no
    result. A search skips no scan, else its evidence would not be that of the other shards; it
    ends before it needs more than `KEPT_STEPS`.
    """

    def __init__(self) -> None:
        self._left: dict[Searching, deque[tuple[int, Slices[SearchReport]]]] = {}
        self._searching: tuple[Searching, Slices[SearchReport]] | None = None

    def __bool__(self) -> bool:
        return self._searching is not None or any(self._left.values())

    def add(self, search: Searching, scan: Scan) -> None:
        """Queue one more scan for a search, unless it is not newer or too many wait."""
        left = self._left.setdefault(search, deque())
        if len(left) < KEPT_STEPS and (not left or scan.step > left[-1][0]):
            left.append((scan.step, search.slices(scan)))

    def keep_only(self, jobs: Iterable[RunningJob]) -> None:
        kept = set(jobs)
        self._left = {search: left for search, left in self._left.items() if search in kept}
        if self._searching is not None and self._searching[0] not in kept:
            self._searching = None

    def work(self) -> SearchReport | None:
        """Compute one slice; return the report if it finishes a step, else None."""
        if self._searching is None:
            waiting = [search for search, left in self._left.items() if left]
            if not waiting:
                return None
            first = min(waiting, key=lambda search: self._left[search][0][0])
            self._searching = first, self._left[first].popleft()[1]
        try:
            next(self._searching[1])
        except StopIteration as done:
            self._searching = None
            report: SearchReport = done.value
            return report
        return None
