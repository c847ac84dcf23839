"""The checkpoints of one term: numbered as they are made, and repeated as a sign of life."""

from coordinator.instructions import PublishCheckpoint
from protocol.work import Checkpoint

SIGN_OF_LIFE_NS = 400_000_000
"""The checkpoint goes out again after so long, changed or not."""


class CheckpointSeries:
    """Makes checkpoints of states, and says when the last one goes out once more."""

    def __init__(self, sender: str) -> None:
        self._sender = sender
        self._last: Checkpoint | None = None
        self._last_ns = 0

    def next(
        self, state: bytes, *, term: int, step: int, founded: bool, now_ns: int
    ) -> PublishCheckpoint:
        """Something has changed: others must know, before anybody acts upon it.

        Args:
            state: of the coordinator, as it travels.
            term: of the coordinator.
            step: the last that was applied; -1: none.
            founded: see `Checkpoint`.
            now_ns: by the clock of all events.
        """
        serial = self._last.serial + 1 if self._last else 0
        self._last_ns = now_ns
        self._last = Checkpoint(
            sender=self._sender, term=term, serial=serial, step=step, founded=founded, state=state
        )
        return PublishCheckpoint(self._last)

    def sign_of_life(self, now_ns: int) -> list[PublishCheckpoint]:
        """The last checkpoint once more, where it is time."""
        if self._last is None or now_ns - self._last_ns < SIGN_OF_LIFE_NS:
            return []
        self._last_ns = now_ns
        return [PublishCheckpoint(self._last)]
