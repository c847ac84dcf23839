"""Whether this coordinator may still act: after a pause it listens before it sends anything.

A process that was stopped, or cut off, does not know how long it was away. Another coordinator
may act by now, and says so at least twice a second.
"""

from coordinator.instructions import FetchScans, Instruction

PAUSE_NS = 1_000_000_000
"""So long between two turns of the loop, and the process was stopped."""
LISTEN_NS = 1_200_000_000
"""Who has just been given up hears in this time of who takes over: that one asks the workers for
up to half a second, and then gives a sign of life at least twice a second."""


class SelfFencing:
    """Holds back what is to be done until it is certain that nobody else does it."""

    def __init__(self, now_ns: int) -> None:
        self._last_turn_ns = now_ns
        self._until_ns = 0
        self._held: list[Instruction] = []

    def turn(self, now_ns: int) -> None:
        """The loop turns, or is about to do what a turn came to."""
        if now_ns - self._last_turn_ns > PAUSE_NS:
            self.listen(now_ns)
        self._last_turn_ns = now_ns

    def listen(self, now_ns: int) -> None:
        """Send nothing for a moment: another coordinator may have taken over meanwhile."""
        self._until_ns = now_ns + LISTEN_NS

    def is_listening(self, now_ns: int) -> bool:
        """Whether to listen on."""
        return now_ns < self._until_ns

    def cleared(self, instructions: list[Instruction], now_ns: int) -> list[Instruction]:
        """What may be done now, what was held back first; also a turn may have been stopped.

        Lost scans are asked for at once: that tells nobody anything, and they are not waited for
        as long as it listens.
        """
        self.turn(now_ns)
        held = [*self._held, *instructions]
        self._held = []
        if not self.is_listening(now_ns):
            return held
        self._held = [do for do in held if not isinstance(do, FetchScans)]
        return [do for do in held if isinstance(do, FetchScans)]
