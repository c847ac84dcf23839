"""Whether the bridge counts its steps anew: coordinator and workers must see it at the same scan.

A bridge that starts goes on after the step that the coordinator knows. If nobody answers it, it
starts at 0, and a coordinator that carries on from a checkpoint would wait for a step that comes
in an hour. Scans that repeat or come late are no new count: their stamps are not newer.

A step far above all others is no honest one either. One such scan is left out: if it were
followed, all scans of the real count would be over.
"""

from protocol.steps import Scan

NEEDED = 3
"""So many scans in a row, each later than the one before: one alone may be anything."""
NEEDED_OF_OLDER = 20
"""The same where their stamps are older than the newest scan's, which may have been a wrong one."""
HUGE_JUMP = 10_000
"""Steps: two kilometres of driving. A robot that was out of reach for longer is searched for."""


def is_huge_jump(scan: Scan, newest: Scan | None) -> bool:
    """Whether a scan's step is so far above the newest one that it cannot follow it."""
    return newest is not None and scan.step > newest.step + HUGE_JUMP


class StepResetDetector:
    """Told of scans that do not go on with the count; says when they are the beginning of another.

    These are scans of steps that are over, and those after a huge jump.
    """

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None
        self._in_a_row = self._newer_in_a_row = 0

    def goes_on(self) -> None:
        """A scan went on with the count so far."""
        self._last, self._in_a_row, self._newer_in_a_row = None, 0, 0

    def starts_anew(self, scan: Scan, newest: Scan | None) -> bool:
        """Take a scan that does not go on with the count.

        Args:
            scan: any such scan.
            newest: the last scan of the count so far.
        """
        if newest is None or newest.step <= scan.step <= newest.step + HUGE_JUMP:
            self.goes_on()
            return False
        last, self._last = self._last, (scan.step, scan.stamp_ns)
        follows = last is not None and last[0] < scan.step and last[1] < scan.stamp_ns
        is_newer = scan.stamp_ns > newest.stamp_ns
        self._in_a_row = self._in_a_row + 1 if follows else 1
        self._newer_in_a_row = (self._newer_in_a_row if follows else 0) + 1 if is_newer else 0
        return self._newer_in_a_row >= NEEDED or self._in_a_row >= NEEDED_OF_OLDER
