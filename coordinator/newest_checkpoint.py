"""What one that stands by keeps of the checkpoints it hears."""

from coordinator.checkpoint import arrival
from coordinator.pose.lateness import Lateness
from protocol.work import Checkpoint


class NewestCheckpoint:
    """The one to carry on from, and what all of them say of a robot's clock."""

    def __init__(self) -> None:
        self.checkpoint: Checkpoint | None = None
        """The newest; None before any was heard."""
        self._lateness = Lateness()

    @property
    def usual_delay_ns(self) -> int | None:
        """For `PoseTracker.begin`; None while nothing was heard of a live robot."""
        return self._lateness.usual_ns

    def hear(self, checkpoint: Checkpoint, now_ns: int) -> bool:
        """Another coordinator has published one; whether it is the newest.

        What is said again tells nothing of the delay: its age was that of the first time.
        """
        if self.checkpoint is not None and checkpoint.rank <= self.checkpoint.rank:
            return checkpoint.rank == self.checkpoint.rank  # said again, as a sign of life
        self.checkpoint = checkpoint
        if (arrived := arrival(checkpoint, now_ns)) is not None:
            self._lateness.of(*arrived)
        return True
