"""The last steps, for workers that join late."""

from collections import deque

from protocol.steps import Scan


class StepHistory:
    """A bounded memory of steps.

    Args:
        capacity: steps kept; older ones are forgotten.
    """

    def __init__(self, capacity: int) -> None:
        self._scans: deque[Scan] = deque(maxlen=capacity)

    def add(self, scan: Scan) -> None:
        """Remember a step.

        Raises:
            ValueError: its number does not follow those before it.
        """
        if self._scans and scan.step <= self._scans[-1].step:
            raise ValueError(f"step {scan.step} after step {self._scans[-1].step}")
        self._scans.append(scan)

    def between(self, first: int, last: int) -> list[Scan]:
        """The steps from `first` to `last`, both included, as far as they are remembered."""
        return [scan for scan in self._scans if first <= scan.step <= last]

    def newest(self) -> Scan | None:
        """The last step; None before the first."""
        return self._scans[-1] if self._scans else None
