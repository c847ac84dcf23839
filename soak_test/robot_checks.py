"""All checks of one robot, and what of all that is heard each of them is told."""

from collections.abc import Sequence
from dataclasses import dataclass

import msgpack

from process_runtime.settings import Settings
from protocol import keys
from protocol.answers import Belief, Status
from protocol.codec import decode
from protocol.errors import MalformedMessageError
from protocol.job_events import JobEvents
from protocol.keys import WorkerKey, WorkerTopic
from protocol.message import Message
from protocol.steps import LaserReading, OdometryReading, Scan
from protocol.work import TrackReport
from soak_test.availability import Availability, DoneFault
from soak_test.belief_checks import ClusterChanges, Probabilities
from soak_test.delay_check import Delays
from soak_test.end_causes import EndCauses
from soak_test.kidnap_check import Kidnappings
from soak_test.listener import Arrived, Heard, StatusHeard, TokenHeard
from soak_test.pose_checks import Ages, Answered, Question
from soak_test.recovery_check import Recovery
from soak_test.robot import TRUTH_KEY, TrueMotion
from soak_test.room_check import RoomsHeld, all_rooms_held
from soak_test.step_check import Steps
from soak_test.true_poses import JudgedBelief, TruePoses
from soak_test.truth_check import Truth, truth_held
from soak_test.verdict import Break, Verdict

HAND_OVER_S = 2.0
"""A step waits so long for a job that has just been given to another worker."""

_KINDS: dict[str, type[Message]] = {
    keys.EVENTS: JobEvents,
    keys.BELIEF: Belief,
    keys.SCAN: Scan,
    keys.LASER_READING: LaserReading,
    keys.ODOMETRY_READING: OdometryReading,
    TRUTH_KEY: TrueMotion,
}


@dataclass(frozen=True)
class Promised:
    """What is asked of one robot."""

    rooms: bool
    """The world is that of the eight rooms: a place in each is held from the bootstrap on."""
    delay_s: float | None
    """From scan to belief, for 99 % of the steps; None: nothing is."""
    chaos: bool


class RobotChecks:
    """Told of everything that one robot's processes say, and of faults; answers verdicts."""

    def __init__(self, settings: Settings, promised: Promised) -> None:
        self.availability = Availability()
        self.recovery = Recovery(self.availability)
        self._causes, self._true_poses = EndCauses(), TruePoses()
        self.clusters = ClusterChanges(self._causes)
        self._rooms = RoomsHeld(self._causes)
        self._promised = promised
        self._answered = Answered(self.availability)
        self._ages = Ages(settings.coordinator.stale_after_s)
        self._probabilities, self._truth = Probabilities(), Truth()
        found = all_rooms_held if promised.rooms else truth_held
        self._kidnappings = Kidnappings(self.availability, found)
        self._steps = Steps(self.availability)
        longest_s = settings.coordinator.step_deadline_s + HAND_OVER_S
        self._delays = Delays(self.availability, promised.delay_s, longest_s)
        self.seen: dict[str, bytes] = {}
        """The newest good message of each key."""
        self.status: Status | None = None
        self.belief: Belief | None = None
        self.heard: dict[int, int] = {}
        """By term the last step whose belief came before any of a later term."""
        self._stamps: dict[int, int] = {}
        self._foreign: list[Break] = []
        self.judging = False
        """Off until the bootstrap is over."""

    @property
    def ready(self) -> bool:
        """Whether the first places have been found."""
        if self._promised.rooms:
            return self._rooms.complete
        return self.belief is not None and self.belief.state not in ("searching", "lost")

    def fault(self, fault: DoneFault) -> None:
        """A fault that may concern this robot was done."""
        self.availability.fault(fault)
        self.recovery.fault(fault)

    def on_arrived(self, arrived: Arrived) -> None:
        """Something was heard."""
        match arrived:
            case Question():
                if self.judging:
                    self._answered.on_question(arrived)
                    self._ages.on_question(arrived)
            case TokenHeard(at_ns=at_ns, key=keys.COORDINATOR_ALIVE, alive=alive):
                if self.judging:
                    self.availability.token(at_ns, alive=alive)
            case StatusHeard(status=status):
                self.status = status
            case Heard():
                self._message(arrived)

    def acting(self) -> str:
        """Name of the coordinator that spoke last; empty before any did."""
        return self.belief.sender if self.belief else ""

    @property
    def summary(self) -> str:
        """How it goes, in a few words."""
        if self.belief is None:
            return "no belief"
        return f"step {self.belief.step}, {len(self.belief.hypotheses)} places"

    def verdicts(self, now_ns: int) -> Sequence[Verdict]:
        """On every promise, in the order of the table."""
        rows = [self._answered.verdict(), *self._ages.verdicts()]
        rows += [self.availability.verdict(now_ns)] if self._promised.chaos else []
        rows += [*self._truth.verdicts(), self._probabilities.verdict()]
        rows.append(self._rooms.verdict() if self._promised.rooms else self._truth.localized())
        rows += [*self._steps.verdicts(), *self._delays.verdicts(), self._apart()]
        if self._promised.chaos:
            rows += [*self.recovery.verdicts(now_ns), self._kidnappings.verdict(now_ns)]
        return rows

    def _message(self, heard: Heard) -> None:
        if heard.key not in _KINDS:
            self._report(heard)
            return
        try:
            message = decode(heard.payload, _KINDS[heard.key])
        except MalformedMessageError:
            return  # our own rubbish
        self.seen[heard.key] = heard.payload
        match message:
            case JobEvents():
                self._causes.on_events(message)
            case Belief():
                self._belief(heard.at_ns, message)
            case Scan():
                self._delays.scan(heard.at_ns, message.step)
                self._steps.scan(message.step)
                self._remember(message.stamp_ns, message.step)
            case TrueMotion():
                truth = message.map_from_robot, message.kidnapped
                self._judge(self._true_poses.truth(message.stamp_ns, *truth))

    def _belief(self, at_ns: int, belief: Belief) -> None:
        self.belief = belief
        if belief.term >= max(self.heard, default=0):
            self.heard[belief.term] = belief.step
        self.clusters.on_belief(at_ns, belief)
        self._judge(self._true_poses.on_belief(at_ns, belief))
        if not self.judging:
            return
        self._probabilities.on_belief(at_ns, belief)
        self._steps.on_belief(at_ns, belief)
        self._delays.believed(at_ns, belief.step)
        self.recovery.believed(place.cluster for place in belief.hypotheses)
        step = self._stamps.get(belief.stamp_ns)
        if step is not None and step != belief.step:
            what = f"the belief of step {belief.step} has the stamp of step {step}"
            self._foreign.append(Break(at_ns, what))

    def _judge(self, judged: JudgedBelief | None) -> None:
        if judged is None or self._kidnappings.looked_for(judged):
            return
        self._rooms.judge(judged)
        if self.judging:
            self._truth.judge(judged)

    def _report(self, heard: Heard) -> None:
        """Only who reports what is looked at: whole reports are too many to be decoded."""
        try:
            report, key = msgpack.unpackb(heard.payload), keys.parsed(heard.key)
            is_track_report = report["schema"] == TrackReport.__struct_config__.tag
            if is_track_report and isinstance(key, WorkerKey) and key.topic is WorkerTopic.REPORT:
                self.recovery.reported(heard.at_ns, key.worker, str(report["job_id"]))
                self.seen[heard.key] = heard.payload
        except (MalformedMessageError, ValueError, TypeError, KeyError, msgpack.UnpackException):
            return  # our own rubbish

    def _remember(self, stamp_ns: int, step: int) -> None:
        self._stamps[stamp_ns] = step
        while len(self._stamps) > 4096:
            del self._stamps[next(iter(self._stamps))]

    def _apart(self) -> Verdict:
        """A robot's stamps are its own: nanoseconds of the time of day."""
        unknown = self._true_poses.unknown
        return Verdict(
            promise="every belief is of this robot's own scan",
            target="always",
            measured=f"{len(self._foreign)} are not; {unknown} whose truth was not heard",
            kept=not self._foreign,
            breaks=tuple(self._foreign),
            figures={"foreign": len(self._foreign), "unknown": unknown},
        )
