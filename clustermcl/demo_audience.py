"""Receive the messages of a demo's processes, until the last belief."""

import time
from collections.abc import Callable

import zenoh

from clustermcl.demo_show import Show
from clustermcl.demo_summary import DemoSummary
from clustermcl.demo_view import View
from protocol import keys
from protocol.answers import Belief
from protocol.codec import decode
from protocol.errors import ClusterMclError
from protocol.job_events import JobEvents
from protocol.message import PoseTuple
from protocol.steps import TruePose
from zenoh_link.inbox import Inbox
from zenoh_link.wire import Events, Publisher, Received, Token, subscribe, watch

LOCALIZED_STEPS = 20
"""The demo of a simulated robot ends after this many localized steps."""

_SILENCE_S = 60.0
_KEPT_TRUTHS = 64
_POLL_S = 0.05


class StalledError(ClusterMclError):
    """The processes run, but no belief arrives."""

    def __init__(self, *, silent_s: float) -> None:
        self.silent_s = silent_s
        super().__init__(f"no belief has arrived for {silent_s:.0f} s")


class Audience:
    """Receives the beliefs, the events and the ground truth."""

    def __init__(
        self, session: zenoh.Session, show: Show, view: View, check: Callable[[], None]
    ) -> None:
        self._show, self._view, self._check = show, view, check
        self._inbox: Events = Inbox({"belief": 4096, "events": 4096, "truth": 4096})
        self._alive: set[str] = set()
        self._truths: dict[int, PoseTuple] = {}
        self._summary = DemoSummary()
        self._truth = Publisher(session, keys.TRUTH) if show.reference else None
        subscribe(session, keys.BELIEF, self._inbox, "belief")
        subscribe(session, keys.EVENTS, self._inbox, "events")
        subscribe(session, keys.TRUTH, self._inbox, "truth")
        watch(session, keys.ALL_WORKERS_ALIVE, self._inbox)

    def wait_for_workers(self, count: int) -> None:
        """Wait for all workers: a step without a report would be lost."""
        while len(self._alive) < count:
            self._view.starting(len(self._alive), count)
            self._hear()
        self._view.starting(count, count)

    def follow(self) -> DemoSummary:
        """Receive beliefs until the last one."""
        heard_s = time.monotonic()
        while not self._over():
            if self._hear():
                heard_s = time.monotonic()
            elif time.monotonic() - heard_s > _SILENCE_S and not self._show.may_stand:
                raise StalledError(silent_s=_SILENCE_S)
        return self._summary

    def truth_of(self, belief: Belief) -> PoseTuple | None:
        """Ground truth at the step of a belief; None: unknown."""
        if self._show.reference is not None:
            return self._show.reference.pose_at(belief.stamp_ns)
        deadline_s = time.monotonic() + 1.0
        while self._show.simulated and belief.step not in self._truths:
            if time.monotonic() > deadline_s:
                break
            self._hear()
        return self._truths.get(belief.step)

    def _over(self) -> bool:
        summary = self._summary
        if summary.belief is None:
            return False
        if self._show.ends_when_localized and summary.localized_steps >= LOCALIZED_STEPS:
            return True
        return summary.belief.last

    def _hear(self) -> bool:
        """Wait briefly for a message and handle it; return whether it was a belief."""
        self._check()
        match self._inbox.get(_POLL_S):
            case Token(key=key, alive=alive):
                (self._alive.add if alive else self._alive.discard)(key)
            case Received(key=keys.TRUTH, payload=payload):
                truth = decode(payload, TruePose)
                self._truths[truth.step] = truth.map_from_robot
                while len(self._truths) > _KEPT_TRUTHS:
                    del self._truths[next(iter(self._truths))]
            case Received(key=keys.EVENTS, payload=payload):
                for numbered in decode(payload, JobEvents).events:
                    self._summary.on_event(numbered.event)
                    self._view.happened(numbered)
            case Received(key=keys.BELIEF, payload=payload):
                self._on_belief(decode(payload, Belief))
                return True
        return False

    def _on_belief(self, belief: Belief) -> None:
        self._summary.on_belief(belief)
        truth = self._truths.get(belief.step)
        if self._truth is not None and (truth := self.truth_of(belief)) is not None:
            self._truth.put(TruePose(sender="demo", step=belief.step, map_from_robot=truth))
        self._view.believed(belief, truth)
