"""One coordinator process as follower or leader, from its start to its end.

A follower watches the leader. When the leader dies, the follower recovers the state from received
checkpoints and the workers' reports, and leads. A message with a higher term deposes a leader.
"""

import math
from collections.abc import Callable
from typing import Literal, TypeAlias

from clustermcl.coordinator import events
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


class Replica:
    """A coordinator process, which begins as a follower.

    It takes over after a silence of the leader of `take_over_after_s`.
    """

    def __init__(self, take_over_after_s: float, now_ns: int) -> None:
        self._take_over_after_s = take_over_after_s
        self.newest: Checkpoint | None = None
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
        self._linked = True
        self._on_sign_of_life(now_ns)

    def _on_sign_of_life(self, now_ns: int) -> None:
        self._last_sign_ns, self._vanished_ns = now_ns, math.inf

    def is_leader_dead(self, now_ns: int) -> bool:
        """Return whether this follower should lead.

        If the leader's token vanishes while the own link is up, the router has lost the leader.
        Otherwise the time-out is longer, so that a lost link on either side can recover first.
        """
        is_gone = now_ns >= self._vanished_ns + SETTLE_NS
        is_silent = now_ns - self._last_sign_ns >= int(self._take_over_after_s * 1e9)
        return self.coordinator is None and self._linked and (is_gone or is_silent)

    def lead(
        self,
        coordinator: Coordinator,
        now_ns: int,
        handle: Callable[[events.Event, int], list[Instruction]],
    ) -> None:
        """Recover the state, then lead, with a new coordinator; `handle` passes events on to it."""
        self.coordinator, self._decide = coordinator, handle
        self.newest = None
        self._membership, self._may_decide = Membership(), True
        self._last_turn_ns, self._listens_until_ns = now_ns, 0
        self._held: list[Instruction] = []

    def handle(self, event: events.Event | events.TokenChanged, now_ns: int) -> list[Instruction]:
        """Process an event; return instructions for `release`."""
        is_sign_of_life = False
        if isinstance(event, events.CheckpointArrived):
            known, arrived = self.newest or event.checkpoint, event.checkpoint
            is_sign_of_life = arrived.rank >= known.rank or arrived.term > known.term
            self.newest = max(arrived, known, key=lambda one: one.rank)
        if self.coordinator is not None:
            self._turn(now_ns)
            meant = self._meaning_of(event, now_ns)
            due = [*self._permission(now_ns), *meant]
            instructions = [do for one in due for do in self._decide(one, now_ns)]
            left = self._membership.left(now_ns)
            return instructions + [do for one in left for do in self._decide(one, now_ns)]
        match event:
            case events.CheckpointArrived() if is_sign_of_life:
                self._on_sign_of_life(now_ns)
            case events.TokenChanged(worker=None, alive=True):
                self._on_sign_of_life(now_ns)
            case events.TokenChanged(worker=None, alive=False):
                self._vanished_ns = now_ns
            case events.LinkChanged(up=up):
                self._linked = up
                self._on_sign_of_life(now_ns)
        return []

    def release(self, instructions: list[Instruction], now_ns: int) -> list[Instruction]:
        """Return the instructions that may be carried out now, including those held back."""
        if self.role in ("follower", "deposed"):
            return []
        listens = self._turn(now_ns)
        held = [*self._held, *instructions]
        # Scans are always requested: the bridge keeps them for a limited time.
        self._held = [do for do in held if listens and not isinstance(do, FetchScans)]
        return [do for do in held if not listens or isinstance(do, FetchScans)]

    def may_answer(self, now_ns: int) -> bool:
        """Return whether this coordinator leads, and no other one can be leading."""
        return self.role == "leading" and not self._turn(now_ns)

    def _turn(self, now_ns: int) -> bool:
        """Return whether to hold back what is decided, because another one may be leading.

        A process that was stopped or cut off may have been replaced. It waits until a successor's
        state would have arrived.
        """
        if now_ns - self._last_turn_ns > PAUSE_NS:
            self._listens_until_ns = now_ns + LISTEN_NS
        self._last_turn_ns = now_ns
        return now_ns < self._listens_until_ns

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
                    self._listens_until_ns = now_ns + LISTEN_NS
                self._membership.link(up, now_ns)
                return []
            case _:
                return [event]

    def _permission(self, now_ns: int) -> list[events.Event]:
        """Return `LinkChanged` if the coordinator may decide from now on, or may no longer."""
        may_decide = self._membership.linked and now_ns >= self._listens_until_ns
        if may_decide == self._may_decide:
            return []
        self._may_decide = may_decide
        return [events.LinkChanged(up=may_decide)]


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

    def token(self, worker: str, alive: bool, now_ns: int) -> list[events.WorkerChanged]:
        """Process a worker's token; return the changes that are certain."""
        if not alive:
            if worker in self._present:
                self._gone_ns.setdefault(worker, now_ns)
            return []
        if worker not in self._present:
            self._present.add(worker)
            return [events.WorkerChanged(worker, "joined")]
        gone_ns = self._gone_ns.pop(worker, None)
        if gone_ns is None or self._is_unsure(now_ns):
            return [events.WorkerChanged(worker, "returned")]
        return [events.WorkerChanged(worker, how) for how in ("left", "joined")]

    def left(self, now_ns: int) -> list[events.WorkerChanged]:
        """Return the workers whose absence has become certain."""
        if self._is_unsure(now_ns):
            return []
        left = [w for w, gone_ns in self._gone_ns.items() if now_ns >= gone_ns + SETTLE_NS]
        for worker in left:
            del self._gone_ns[worker]
            self._present.discard(worker)
        return [events.WorkerChanged(worker, "left") for worker in sorted(left)]

    def _is_unsure(self, now_ns: int) -> bool:
        return not self.linked or now_ns < self._trust_from_ns
