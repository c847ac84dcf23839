"""Whether the bridge has another map: a restarted bridge must be followed, one stray scan not."""

from protocol.steps import Scan

NEEDED = 3
"""So many scans of the other map in a row, and none of ours between: one alone may be anything."""


class MapChangeDetector:
    """Told of each scan; says when the bridge has been started anew with another map.

    A second bridge on the same robot's name, or a stray message, is not followed: scans of our own
    map come between. A bridge that waits for a belief sends the same scan again, which counts.
    """

    def __init__(self) -> None:
        self._digest, self._step = "", -1
        self._in_a_row = 0

    def is_another(self, scan: Scan, ours: str) -> bool:
        """Take a scan.

        Args:
            scan: any that arrives.
            ours: digest of the map in which the robot is looked for.
        """
        if scan.map_digest == ours:
            self._in_a_row = 0
            return False
        follows = scan.map_digest == self._digest and scan.step >= self._step
        self._in_a_row = self._in_a_row + 1 if follows else 1
        self._digest, self._step = scan.map_digest, scan.step
        return self._in_a_row >= NEEDED
