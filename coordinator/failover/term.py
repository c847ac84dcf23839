"""One coordinator's term: how it begins, how it is handed on, and when it is over.

A term is a number that stands above those of all terms before. Whoever hears of a higher one no
longer acts: workers refuse its orders, clients its beliefs.
"""

from coordinator.checkpoint import CheckpointState, to_bytes
from coordinator.failover.state_recovery import PATIENCE_NS, StateRecovery, Told
from coordinator.instructions import AskState, PublishCheckpoint
from protocol.work import Checkpoint, TakeOver

SIGN_OF_LIFE_NS = 400_000_000
"""The checkpoint goes out again after so long, changed or not."""


class Term:
    """Told of terms, workers' answers and states; says whom to ask and what to hand on."""

    def __init__(self, sender: str, term: int, known: Checkpoint | None, now_ns: int) -> None:
        self._sender = sender
        self.term = max(term, known.term + 1 if known else 0)
        self.begun = False
        """Whether all has been heard that is needed to act."""
        self.founded = False
        """Whether the belief has had clusters, or a person has spoken."""
        self.outranked_by: int | None = None
        self._recovery = StateRecovery(known, now_ns)
        self._last: Checkpoint | None = None
        self._last_ns = 0

    @property
    def told(self) -> dict[str, Told]:
        """The answers of the workers that are there."""
        return self._recovery.told

    @property
    def newest(self) -> Checkpoint | None:
        """The newest checkpoint of another coordinator."""
        return self._recovery.newest

    def joined(self, worker: str, now_ns: int, *, missed: bool) -> int:
        """A worker is there.

        Args:
            worker: its name.
            now_ns: by the clock of all events.
            missed: it has jobs by a checkpoint.

        Returns:
            Until when it gets no orders, as it is asked before.
        """
        if self.begun and self.founded and not missed:
            return 0
        self._recovery.expect(worker)
        return now_ns + PATIENCE_NS

    def left(self, worker: str) -> None:
        """A worker is gone."""
        self._recovery.forget(worker)

    def answered(self, worker: str, told: Told) -> None:
        """A worker tells what it does and what it has heard."""
        self.hear_term(told.term)
        if told.term <= self.term:
            self._recovery.answered(worker, told)

    def hear(self, checkpoint: Checkpoint) -> None:
        """A coordinator published its checkpoint; it may be this one."""
        self.hear_term(checkpoint.term)
        if not self.begun:
            self._recovery.hear(checkpoint)

    def hear_term(self, term: int) -> None:
        """Somebody knows of a term; before the beginning, this one is raised above it."""
        if term > self.term and self.begun:
            self.outranked_by = max(term, self.outranked_by or 0)
        elif term > self.term:
            self.term = term + 1
            self._recovery.ask_all_again()

    def may_begin(self, now_ns: int) -> bool:
        """Whether to wait for no more answers."""
        return not self.begun and self._recovery.is_over(now_ns)

    def questions(self, now_ns: int) -> list[AskState]:
        """Whom to ask now."""
        question = TakeOver(sender=self._sender, term=self.term)
        return [AskState(worker, question) for worker in self._recovery.due(now_ns)]

    def hand_on(self, state: CheckpointState, now_ns: int) -> PublishCheckpoint:
        """Something has changed: others must know, before anybody acts upon it."""
        serial = self._last.serial + 1 if self._last else 0
        self._last_ns = now_ns
        self._last = Checkpoint(
            sender=self._sender,
            term=self.term,
            serial=serial,
            step=state.applied.step if state.applied else -1,
            founded=self.founded,
            state=to_bytes(state),
        )
        return PublishCheckpoint(self._last)

    def sign_of_life(self, now_ns: int) -> list[PublishCheckpoint]:
        """The last checkpoint once more, where it is time."""
        if self._last is None or now_ns - self._last_ns < SIGN_OF_LIFE_NS:
            return []
        self._last_ns = now_ns
        return [PublishCheckpoint(self._last)]
