"""One coordinator process as follower or leader, from its start to its end.

A follower watches the leader. When the leader dies, the follower recovers the state from received
checkpoints and the workers' reports, and leads. A message with a higher term deposes a leader.
"""

from collections.abc import Callable
from typing import Literal, TypeAlias

from clustermcl.belief.pose_tracker import LatencyEstimator
from clustermcl.coordinator import events
from clustermcl.coordinator.checkpoint import arrival
from clustermcl.coordinator.coordinator import Coordinator
from clustermcl.coordinator.instructions import FetchScans, Instruction
from clustermcl.protocol.work import Checkpoint

SETTLE_NS = 100_000_000
"""Zenoh reports tokens as gone some milliseconds before the lost link that caused it [ns]."""
PAUSE_NS = 1_000_000_000
"""A process that has done nothing for longer was stopped [ns]."""
LISTEN_NS = 1_200_000_000
"""Within this time a process that was stopped receives its successor's state: a successor asks the
workers for up to half a second, then publishes its state at least twice a second [ns]."""
GRACE_NS = 2_000_000_000
"""After the link is back: twice the longest pause between two attempts to connect [ns]."""

Role: TypeAlias = Literal["follower", "recovering", "leading", "deposed"]
Change: TypeAlias = events.WorkerJoined | events.WorkerLeft | events.WorkerReturned


class Replica:
    """A coordinator process, which begins as a follower.

    It takes over after a silence of the leader of `take_over_after_s`.
    """

    def __init__(self, take_over_after_s: float, now_ns: int) -> None:
        self._take_over_after_s = take_over_after_s
        self.newest = NewestState()
        """The newest state of other coordinators since this one last began to recover."""
        self.follow(now_ns)

    @property
    def role(self) -> Role:
        if self.coordinator is None:
            return "follower"
        if self.coordinator.term.outranked_by is not None:
            return "deposed"
        return "leading" if self.coordinator.term.begun else "recovering"

    def follow(self, now_ns: int) -> None:
        self.coordinator: Coordinator | None = None
        self._detector = FailureDetector(self._take_over_after_s, now_ns)

    def is_leader_dead(self, now_ns: int) -> bool:
        return self.coordinator is None and self._detector.is_over(now_ns)

    def lead(
        self,
        coordinator: Coordinator,
        now_ns: int,
        handle: Callable[[events.Event, int], list[Instruction]] | None = None,
    ) -> None:
        """Recover the state, then lead, with a new coordinator.

        `handle` passes events on to it, as a recorder does; None: directly.
        """
        self.coordinator, self._decide = coordinator, handle or coordinator.handle
        self.newest = NewestState()
        self._membership, self._fencing = Membership(), SelfFencing(now_ns)
        self._may_decide = True

    def handle(self, event: events.Event | events.TokenChanged, now_ns: int) -> list[Instruction]:
        """Process an event, after `release`; return instructions to carry out."""
        if isinstance(event, events.CheckpointArrived):
            is_newest = self.newest.on_state(event.checkpoint, now_ns)
        if self.coordinator is not None:
            self._fencing.turn(now_ns)
            meant = self._meaning_of(event, now_ns)
            due = [*self._permission(now_ns), *meant]
            instructions = [do for one in due for do in self._decide(one, now_ns)]
            left = self._membership.left(now_ns)
            return instructions + [do for one in left for do in self._decide(one, now_ns)]
        match event:
            case events.CheckpointArrived() if is_newest:
                self._detector.sign_of_life(now_ns)
            case events.TokenChanged(worker=None, alive=True):
                self._detector.sign_of_life(now_ns)
            case events.TokenChanged(worker=None, alive=False):
                self._detector.token_vanished(now_ns)
            case events.LinkChanged(up=up):
                self._detector.link(up, now_ns)
        return []

    def release(self, instructions: list[Instruction], now_ns: int) -> list[Instruction]:
        """Return the instructions that may be carried out now, including those held back.

        Call it directly before the instructions are carried out.
        """
        if self.role in ("follower", "deposed"):
            return []
        return self._fencing.cleared(instructions, now_ns)

    def may_answer(self, now_ns: int) -> bool:
        """Return whether this coordinator leads, and no other one can be leading."""
        if self.role != "leading":
            return False
        self._fencing.turn(now_ns)
        return not self._fencing.is_listening(now_ns)

    def _meaning_of(
        self, event: events.Event | events.TokenChanged, now_ns: int
    ) -> list[events.Event]:
        """Return the coordinator's events that follow from an event of the process."""
        match event:
            case events.TokenChanged(worker, alive):
                # Coordinators' tokens matter to followers only.
                return [*self._membership.token(worker, alive, now_ns)] if worker else []
            case events.LinkChanged(up=up):
                if up and not self._membership.linked:
                    self._fencing.listen(now_ns)
                self._membership.link(up, now_ns)
                return []
            case _:
                return [event]

    def _permission(self, now_ns: int) -> list[events.Event]:
        """Return `LinkChanged` if the coordinator may decide from now on, or may no longer."""
        may_decide = self._membership.linked and not self._fencing.is_listening(now_ns)
        if may_decide == self._may_decide:
            return []
        self._may_decide = may_decide
        return [events.LinkChanged(up=may_decide)]


class NewestState:
    """The newest state to recover from, and the usual delay of a robot's data."""

    def __init__(self) -> None:
        self.checkpoint: Checkpoint | None = None
        self._lateness = LatencyEstimator()

    @property
    def usual_delay_ns(self) -> int | None:
        """For `PoseTracker.begin`; None: no state of a live robot was received."""
        return self._lateness.usual_ns

    def on_state(self, checkpoint: Checkpoint, now_ns: int) -> bool:
        """Store the state of another coordinator; return whether it is the newest one.

        The delay is estimated from the first publication only: a repeated state has an old age.
        """
        if self.checkpoint is not None and checkpoint.rank <= self.checkpoint.rank:
            return checkpoint.rank == self.checkpoint.rank
        self.checkpoint = checkpoint
        if (arrived := arrival(checkpoint, now_ns)) is not None:
            self._lateness.on_arrival(*arrived)
        return True


class FailureDetector:
    """Detects that the leader is dead.

    If the leader's token vanishes while the own link is up, the router has lost the leader.
    Otherwise the time-out is longer, so that a lost link on either side can recover first.
    """

    def __init__(self, take_over_after_s: float, now_ns: int) -> None:
        self._silence_ns = int(take_over_after_s * 1e9)
        self._linked = True
        self._last_sign_ns = now_ns
        self._died_ns: int | None = None

    def sign_of_life(self, now_ns: int) -> None:
        self._last_sign_ns, self._died_ns = now_ns, None

    def token_vanished(self, now_ns: int) -> None:
        """Record that the leader's token vanished; the own link may be about to be lost."""
        self._died_ns = now_ns

    def link(self, up: bool, now_ns: int) -> None:
        """Record whether the own link is up, and restart the time-out."""
        self._linked = up
        self.sign_of_life(now_ns)

    def is_over(self, now_ns: int) -> bool:
        is_gone = self._died_ns is not None and now_ns - self._died_ns >= SETTLE_NS
        return self._linked and (is_gone or now_ns - self._last_sign_ns >= self._silence_ns)


class SelfFencing:
    """Holds back what a leader has decided until no other coordinator can be leading.

    A process that was stopped or cut off may have been replaced. It waits until a successor's state
    would have arrived.
    """

    def __init__(self, now_ns: int) -> None:
        self._last_turn_ns = now_ns
        self._until_ns = 0
        self._held: list[Instruction] = []

    def turn(self, now_ns: int) -> None:
        """Record that the process runs; after a pause, wait for a successor's state first."""
        if now_ns - self._last_turn_ns > PAUSE_NS:
            self.listen(now_ns)
        self._last_turn_ns = now_ns

    def listen(self, now_ns: int) -> None:
        self._until_ns = now_ns + LISTEN_NS

    def is_listening(self, now_ns: int) -> bool:
        return now_ns < self._until_ns

    def cleared(self, instructions: list[Instruction], now_ns: int) -> list[Instruction]:
        """Return the instructions that may be carried out now, older ones first.

        Scans are always requested: the bridge keeps them for a limited time, and a request does no
        harm.
        """
        self.turn(now_ns)
        held = [*self._held, *instructions]
        self._held = []
        if not self.is_listening(now_ns):
            return held
        self._held = [do for do in held if not isinstance(do, FetchScans)]
        return [do for do in held if isinstance(do, FetchScans)]


class Membership:
    """The workers that are present, by their tokens and the coordinator's own link.

    A coordinator that loses its link sees all tokens vanish, although the workers still run. So no
    worker counts as gone while the link is down, or for `GRACE_NS` after it. A vanished token
    counts only if the link stays up for `SETTLE_NS`.
    """

    def __init__(self) -> None:
        self._present: set[str] = set()
        self._gone_ns: dict[str, int] = {}
        self.linked = True
        self._trust_from_ns = 0

    def link(self, up: bool, now_ns: int) -> None:
        if up and not self.linked:
            self._trust_from_ns = now_ns + GRACE_NS
        self.linked = up

    def token(self, worker: str, alive: bool, now_ns: int) -> list[Change]:
        """Process a worker's token; return the changes that are certain."""
        if not alive:
            if worker in self._present:
                self._gone_ns.setdefault(worker, now_ns)
            return []
        if worker not in self._present:
            self._present.add(worker)
            return [events.WorkerJoined(worker)]
        gone_ns = self._gone_ns.pop(worker, None)
        if gone_ns is None or self._is_unsure(now_ns):
            return [events.WorkerReturned(worker)]
        return [events.WorkerLeft(worker), events.WorkerJoined(worker)]

    def left(self, now_ns: int) -> list[Change]:
        """Return the workers whose absence has become certain."""
        if self._is_unsure(now_ns):
            return []
        left = [w for w, gone_ns in self._gone_ns.items() if now_ns >= gone_ns + SETTLE_NS]
        for worker in left:
            del self._gone_ns[worker]
            self._present.discard(worker)
        return [events.WorkerLeft(worker) for worker in sorted(left)]

    def _is_unsure(self, now_ns: int) -> bool:
        return not self.linked or now_ns < self._trust_from_ns
