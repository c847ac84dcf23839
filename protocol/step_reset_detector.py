"""Whether the bridge counts its steps anew: coordinator and workers must see it at the same scan.

A bridge that starts goes on after the step that the coordinator knows. If nobody answers it, it
starts at 0, and a coordinator that carries on from a checkpoint would wait for a step that comes
in an hour. Scans that repeat or come late are no new count: their stamps are not newer.
"""

from protocol.steps import Scan

NEEDED = 3
"""So many scans in a row, each later than the one before: one alone may be anything."""


class StepResetDetector:
    """Told of scans whose step is over; says when they are the beginning of a new count."""

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None
        self._in_a_row = 0

    def starts_anew(self, scan: Scan, newest: Scan | None) -> bool:
        """Take a scan.

        Args:
            scan: of a step that is over.
            newest: the last scan of the count so far.
        """
        if newest is None or scan.stamp_ns <= newest.stamp_ns or scan.step >= newest.step:
            self._last, self._in_a_row = None, 0
            return False
        last, self._last = self._last, (scan.step, scan.stamp_ns)
        follows = last is not None and last[0] < scan.step and last[1] < scan.stamp_ns
        self._in_a_row = self._in_a_row + 1 if follows else 1
        return self._in_a_row >= NEEDED
