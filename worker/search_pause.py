"""When searches compute nothing: while a step's tracked clusters are waited for."""

LONGEST_NS = 100_000_000
"""After the first scan that is not decided. Who tracks for longer has lost a worker, or there is
more to do than time; searches have to go on then, for it may be them that a step waits for."""


class SearchPause:
    """Tracked clusters come first, also those of other workers, which want the same cores.

    Slices alone do not see to that: many searches at once leave the trackers of other processes
    a share of the cores like their own.
    """

    def __init__(self) -> None:
        self._scanned_step = self._believed_step = -1
        self._since_ns = 0
        self._founded = False

    def scanned(self, step: int, now_ns: int) -> None:
        """A step's scan has come."""
        if self._scanned_step <= self._believed_step:
            self._since_ns = now_ns
        self._scanned_step = step

    def believed(self, step: int, *, founded: bool) -> None:
        """A coordinator has decided a step; without any clusters it waits for searches."""
        self._believed_step, self._founded = step, founded

    def left_ns(self, now_ns: int) -> int:
        """For so long no search is to compute, unless the step is decided sooner."""
        if not self._founded or self._scanned_step <= self._believed_step:
            return 0
        return max(self._since_ns + LONGEST_NS - now_ns, 0)
