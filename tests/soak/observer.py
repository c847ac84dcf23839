"""Passes the messages of a robot's processes to the promises."""

from collections.abc import Sequence

import msgpack

from process_runtime.settings import Settings
from protocol import keys
from protocol.answers import Belief
from protocol.codec import decode
from protocol.errors import MalformedMessageError
from protocol.job_events import JobEvents
from protocol.keys import WorkerKey, WorkerTopic
from protocol.message import Message, PoseTuple
from protocol.steps import LaserReading, OdometryReading, Scan
from robot_simulator.driver import TRUTH_KEY, TrueMotion
from robot_simulator.worlds.eight_rooms import copies_in_all_rooms, eight_rooms
from tests.soak.listener import Arrived, Received
from tests.soak.pose_promises import AgeTrue, Answered, Question
from tests.soak.promise import Outages, Verdict
from tests.soak.step_promise import StepsOnce
from tests.soak.truth_promise import TruthHeld

HAND_OVER_S = 2.0
"""A step waits this long for a job that was just given to another worker."""
_REPORTED_LATELY_NS = 2_000_000_000
_KINDS: dict[str, type[Message]] = {
    keys.EVENTS: JobEvents,
    keys.BELIEF: Belief,
    keys.SCAN: Scan,
    keys.LASER_READING: LaserReading,
    keys.ODOMETRY_READING: OdometryReading,
    TRUTH_KEY: TrueMotion,
}


def _only_itself(map_from_robot: PoseTuple) -> Sequence[PoseTuple]:
    return (map_from_robot,)


class Observer:
    """The promises of one robot.

    Args:
        settings: settings of the robot.
        world: name of its world; in `eight_rooms` each room must keep a place.
    """

    def __init__(self, settings: Settings, world: str) -> None:
        self.outages = Outages()
        places_of = copies_in_all_rooms if world == eight_rooms.__name__ else _only_itself
        self._truth = TruthHeld(self.outages, places_of)
        self._answered = Answered(self.outages)
        self._age = AgeTrue(settings.coordinator.stale_after_s)
        longest_s = settings.coordinator.step_deadline_s + HAND_OVER_S
        self._steps = StepsOnce(self.outages, longest_s)
        self._reporters: dict[str, tuple[str, int]] = {}
        self._belief: Belief | None = None
        self.seen: dict[str, bytes] = {}
        """The newest well-formed message of each key."""
        self.is_judging = False
        """Set when the first search is over."""

    @property
    def is_ready(self) -> bool:
        """Whether the first search is over."""
        return self._truth.is_complete

    @property
    def leader(self) -> str:
        """Name of the coordinator whose belief arrived last; empty before that."""
        return self._belief.sender if self._belief else ""

    @property
    def summary(self) -> str:
        """One line on the present state."""
        if self._belief is None:
            return "no belief"
        return f"step {self._belief.step}, {len(self._belief.hypotheses)} places"

    def trackers(self, now_ns: int) -> list[str]:
        """Return the names of the workers that track a cluster now."""
        recent = now_ns - _REPORTED_LATELY_NS
        return sorted({worker for worker, at_ns in self._reporters.values() if at_ns >= recent})

    def on_arrived(self, arrived: Arrived) -> None:
        """Take a message, or the outcome of a pose query."""
        match arrived:
            case Question() if self.is_judging:
                self._answered.on_question(arrived)
                self._age.on_question(arrived)
            case Received(key=key) if key in _KINDS:
                self._on_message(arrived)
            case Received():
                self._on_report(arrived)

    def verdicts(self, now_ns: int) -> list[Verdict]:
        return [
            self._answered.verdict(),
            self._age.verdict(),
            self._truth.verdict(now_ns),
            self._steps.verdict(),
        ]

    def _on_message(self, received: Received) -> None:
        try:
            message = decode(received.payload, _KINDS[received.key])
        except MalformedMessageError:
            return  # injected by the soak itself
        self.seen[received.key] = received.payload
        match message:
            case JobEvents():
                self._truth.on_events(message)
            case TrueMotion():
                self._truth.on_truth(message.stamp_ns, message.map_from_robot, message.kidnapped)
            case Scan():
                self._steps.on_scan(received.at_ns, message.step)
            case Belief():
                self._belief = message
                self._truth.on_belief(received.at_ns, message)
                if self.is_judging:
                    self._steps.on_belief(received.at_ns, message)

    def _on_report(self, received: Received) -> None:
        """Read only the job of a report: decoding all reports completely takes too long."""
        try:
            report, key = msgpack.unpackb(received.payload), keys.parsed(received.key)
            job_id = str(report["job_id"])
            is_cluster = job_id.startswith("c")
            if is_cluster and isinstance(key, WorkerKey) and key.topic is WorkerTopic.REPORT:
                self._reporters[job_id] = key.worker, received.at_ns
                self.seen[received.key] = received.payload
        except (MalformedMessageError, ValueError, TypeError, KeyError, msgpack.UnpackException):
            return  # injected by the soak itself
