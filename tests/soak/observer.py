"""Receives all messages of a robot, queries its pose, and passes both to the promises."""

import logging
import time
from collections.abc import Callable
from typing import TypeVar

import msgspec

from clustermcl.link.node import Node
from clustermcl.link.wire import Received
from clustermcl.protocol import keys
from clustermcl.protocol.answers import Belief, PoseAnswer
from clustermcl.protocol.message import Message
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.work import Reported
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.stop import StopFlag
from tests.soak.driver import TRUTH_KEY, TrueMotion
from tests.soak.eight_rooms import copies_in_all_rooms, eight_rooms
from tests.soak.promises import AgeTrue, Answered, Outages, Question, StepsOnce, TruthHeld, Verdict

HAND_OVER_S = 2.0
"""A step waits this long for a job that was just given to another worker."""
ASK_TIMEOUT_S = 1.0
_REPORTED_LATELY_NS = 2_000_000_000
_KEPT = 20_000

M = TypeVar("M", bound=Message)


class _Report(msgspec.Struct):
    """The fields read of a worker's report: decoding all reports completely takes too long."""

    sender: str
    job_id: str = ""
    reports: "tuple[_Report, ...]" = ()


class Observer:
    """A client of one robot that holds it to the promises."""

    def __init__(self, settings: Settings, world: str, stop: StopFlag) -> None:
        self.outages = Outages()
        alike = world == eight_rooms.__name__
        self._truth = TruthHeld(
            self.outages, copies_in_all_rooms if alike else lambda pose: (pose,)
        )
        self._answered = Answered(self.outages)
        self._age = AgeTrue(settings.coordinator.stale_after_s)
        longest_s = settings.coordinator.step_deadline_s + HAND_OVER_S
        self._steps = StepsOnce(self.outages, longest_s)
        self._reporters: dict[str, tuple[str, int]] = {}
        self._belief: Belief | None = None
        self.is_judging = False
        """Set when the first search is over."""
        self._wall_ns = time.time_ns() - time.monotonic_ns()
        # The soak itself sends malformed messages.
        logging.getLogger("clustermcl.link").setLevel("ERROR")
        self.node = Node("soak", "soak", settings, stop, peers=keys.ALL_WORKERS_ALIVE)
        self._subscribe(keys.BELIEF, Belief, self._on_belief)
        self._subscribe(keys.SCAN, Scan, lambda at_ns, scan: self._steps.on_scan(at_ns, scan.step))
        self._subscribe(TRUTH_KEY, TrueMotion, lambda _, motion: self._on_truth(motion))
        self._reports = self.node.poll(keys.ALL_REPORTS, Reported, "report", _KEPT)

    def _subscribe(self, key: str, message: type[M], handler: Callable[[int, M], object]) -> None:
        def on_message(decoded: M, received: Received) -> None:
            handler(self._wall_ns + received.at_ns, decoded)

        self.node.subscribe(key, message, on_message, kind=key, kept=_KEPT)

    @property
    def is_ready(self) -> bool:
        return self._truth.is_complete

    @property
    def leader(self) -> str:
        """Name of the coordinator whose belief arrived last; empty before that."""
        return self._belief.sender if self._belief else ""

    @property
    def summary(self) -> str:
        if self._belief is None:
            return "no belief"
        return f"step {self._belief.step}, {len(self._belief.hypotheses)} places"

    def trackers(self, now_ns: int) -> list[str]:
        recent = now_ns - _REPORTED_LATELY_NS
        return sorted({worker for worker, at_ns in self._reporters.values() if at_ns >= recent})

    def turn(self, wait_s: float) -> None:
        while self.node.turn(wait_s) is not None:
            wait_s = 0.0
        self.node.drain(self._reports, self._on_report)

    def ask_pose(self) -> None:
        """Query the pose without blocking; a later turn counts the outcome."""
        asked_ns = time.time_ns()

        def on_outcome(answer: PoseAnswer | None) -> None:
            if self.is_judging:
                question = Question(asked_ns, time.time_ns(), answer)
                self._answered.on_question(question)
                self._age.on_question(question)

        self.node.ask(
            keys.POSE, PoseAnswer, on_outcome, lambda _problem: on_outcome(None),
            timeout_s=ASK_TIMEOUT_S,
        )  # fmt: skip

    def publish(self, key: str, payload: bytes) -> None:
        self.node.session.put(key, payload)

    def query(self, selector: str, payload: bytes) -> None:
        self.node.session.get(selector, lambda _reply: None, payload=payload, timeout=ASK_TIMEOUT_S)

    def verdicts(self, now_ns: int) -> list[Verdict]:
        return [
            self._answered.verdict(),
            self._age.verdict(),
            self._truth.verdict(now_ns),
            self._steps.verdict(),
        ]

    def _on_belief(self, at_ns: int, belief: Belief) -> None:
        self._belief = belief
        self._truth.on_belief(at_ns, belief)
        if self.is_judging:
            self._steps.on_belief(at_ns, belief.step)

    def _on_truth(self, motion: TrueMotion) -> None:
        self._truth.on_truth(motion.stamp_ns, motion.map_from_robot, motion.kidnapped)

    def _on_report(self, payload: bytes) -> None:
        try:
            report = msgspec.msgpack.decode(payload, type=_Report)
        except (msgspec.DecodeError, ValueError):
            return  # injected by the soak itself
        for one in (report, *report.reports):
            if not one.job_id.startswith("c"):
                continue
            self._reporters[one.job_id] = one.sender, time.time_ns()
