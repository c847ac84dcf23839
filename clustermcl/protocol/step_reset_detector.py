"""Detect that the bridge restarted its count of steps.

A starting bridge continues after the coordinator's newest step. If no coordinator answers, it
starts at 0; a coordinator restored from a checkpoint would then wait an hour for its next step.
Repeated or late scans do not indicate a new count: their stamps are not newer.

A single scan far above all others is discarded. If it were followed, every real scan would be too
old. Coordinator and workers must detect a restart at the same scan, so both use this module.
"""

import msgspec

from clustermcl.protocol.steps import Scan

NEEDED = 3
"""Consecutive scans, each later than the one before, that indicate a new count."""
NEEDED_OF_OLDER = 20
"""The same for scans older than the newest known scan, whose stamp may have been wrong."""
HUGE_JUMP = 10_000
"""Steps, about two kilometres of driving. After a longer gap the robot is searched for."""


def is_huge_jump(scan: Scan, newest: Scan | None) -> bool:
    """Return whether a scan's step is too far above the newest one to follow it."""
    return newest is not None and scan.step > newest.step + HUGE_JUMP


class StepResetDetector(msgspec.Struct):
    """Watches the scans that do not continue the count: past steps, and steps after a huge jump."""

    last: tuple[int, int] | None = None
    """Step and stamp [ns] of the last such scan; None: a scan has continued the count since."""
    in_a_row: int = 0
    newer_in_a_row: int = 0

    def reset(self) -> None:
        """Begin again, because a scan continued the current count."""
        self.last, self.in_a_row, self.newer_in_a_row = None, 0, 0

    def on_other_scan(self, scan: Scan, newest: Scan | None) -> bool:
        """Handle a scan that does not continue the count; return whether a new one has begun."""
        if newest is None or newest.step <= scan.step <= newest.step + HUGE_JUMP:
            self.reset()
            return False
        last, self.last = self.last, (scan.step, scan.stamp_ns)
        follows = last is not None and last[0] < scan.step and last[1] < scan.stamp_ns
        is_newer = scan.stamp_ns > newest.stamp_ns
        self.in_a_row = self.in_a_row + 1 if follows else 1
        self.newer_in_a_row = (self.newer_in_a_row if follows else 0) + 1 if is_newer else 0
        return self.newer_in_a_row >= NEEDED or self.in_a_row >= NEEDED_OF_OLDER
