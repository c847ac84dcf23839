"""Detects an overloaded machine, and a bridge that was restarted with another map."""

from statistics import median

from clustermcl.belief.part import Part
from clustermcl.protocol.steps import Scan

STEPS = 20
"""Number of steps compared: a worker that dies delays a few of them, an overload most."""
LATE_NS, IN_TIME_NS = 100_000_000, 50_000_000
"""Median time from a scan to its decision above which an overload begins, and up to which it
ends."""


class OverloadDetector(Part):
    """Detects from the waiting times of steps that the machine is overloaded."""

    waits_ns: list[int] = []
    is_overloaded: bool = False
    """Whether work that is not urgent is postponed."""

    def on_step_decided(self, waited_ns: int) -> None:
        self.waits_ns = [*self.waits_ns, waited_ns][-STEPS:]
        if len(self.waits_ns) == STEPS:
            bound_ns = IN_TIME_NS if self.is_overloaded else LATE_NS
            self.is_overloaded = median(self.waits_ns) > bound_ns


NEEDED = 3
"""Number of consecutive scans of another map that show a change; one alone may be a stray."""


class MapChangeDetector(Part):
    """Detects that the bridge was restarted with another map.

    A second bridge of the same robot, or a stray message, is ignored, because scans of the present
    map arrive in between. A bridge that waits for a belief repeats its scan, and repetitions count.
    """

    digest: str = ""
    step: int = -1
    """Step of the last scan of the other map."""
    consecutive: int = 0

    def has_changed(self, scan: Scan, present: str) -> bool:
        """Process a scan; return whether the bridge certainly has a map other than `present`."""
        if scan.map_digest == present:
            self.consecutive = 0
            return False
        follows = scan.map_digest == self.digest and scan.step >= self.step
        self.consecutive = self.consecutive + 1 if follows else 1
        self.digest, self.step = scan.map_digest, scan.step
        return self.consecutive >= NEEDED
