"""The bridge's main loop: takes the messages of both sessions and carries out the decisions."""

import logging
import math
import time
from collections.abc import Iterable, Mapping
from typing import TypeAlias

from process_runtime.logs import CauseCounter
from process_runtime.settings import Settings
from process_runtime.stop import StopFlag
from protocol import keys
from protocol.answers import Belief, CommandDone, Status
from protocol.codec import decode as decode_ours
from protocol.errors import MalformedMessageError
from protocol.work import Report, TrackReport
from ros2_bridge import topics
from ros2_bridge.amcl import Amcl
from ros2_bridge.bond import BondThread
from ros2_bridge.core_link import CoreLink
from ros2_bridge.lifecycle import ACTIVATE, CONFIGURE, State
from ros2_bridge.message_types import decode, encode, request_of, response_of
from ros2_bridge.messages_out import diagnostics
from ros2_bridge.node import Called, FromRos, RosPublisher
from ros2_bridge.outputs import (
    Bond,
    GiveMap,
    GivePose,
    NoMotionUpdate,
    Output,
    Publish,
    Reconfigure,
    Refused,
    SearchEverywhere,
)
from ros2_bridge.restart_file import Doing, RestartFile
from ros2_bridge.robot_session import node_name
from ros2_bridge.services import Services
from ros2_bridge.topics import Topics
from zenoh_link.inbox import Inbox
from zenoh_link.wire import Asked, Event, Received

_log = logging.getLogger(__name__)

_POLL_S = 0.05
_STATUS_EVERY_S = 1.0
_PLACES_WITHIN_S = 0.1
"""All places are published when the inbox is empty, at most this long after their belief."""
_CLUSTER = "c"
"""Prefix of the ids of jobs that track a cluster."""


class Unanswered:
    """A query was refused or got no answer."""

    def __init__(self, key: str, words: str) -> None:
        self.key, self.words = key, words


class Answered:
    """A command was answered."""

    def __init__(self, received: Received) -> None:
        self.received = received


InboxEvent: TypeAlias = Event | FromRos | Called | Unanswered | Answered


class BridgeLoop:
    """Owns the state of the bridge, so there is no lock.

    Args:
        settings: of all processes.
        inbox: of both sessions.
        link: to our system.
        publishers: by the names of their topics.
        bond: the heartbeat for nav2.
        file: the state of a killed bridge.
    """

    def __init__(
        self,
        settings: Settings,
        inbox: Inbox[InboxEvent],
        link: CoreLink,
        publishers: Mapping[str, RosPublisher],
        bond: BondThread,
        file: RestartFile,
    ) -> None:
        self._settings, self._inbox, self._link = settings, inbox, link
        self._publishers, self._bond, self._file = publishers, bond, file
        self._amcl = Amcl(settings.ros2)
        name = node_name(settings.ros2)
        node = name.topic(name.name)
        self.services = Services(self._amcl, settings, self._clock_ns, node)
        self._topics = Topics(settings.ros2)
        self._causes = CauseCounter()
        self._next_status_s = 0.0
        self._places_until_s: float | None = None
        self._status: Status | None = None

    def run(self, stop: StopFlag) -> None:
        before = self._file.read()
        if before is not None and before.state is not State.UNCONFIGURED:
            self._resume(before)
        elif self._settings.ros2.autostart:
            self._do(self.services.change(CONFIGURE))
            self._do(self.services.change(ACTIVATE))
        while not stop.is_set():
            event = self._inbox.get(_POLL_S if self._places_until_s is None else 0.0)
            try:
                self._on_event(event)
            except MalformedMessageError as error:
                self._causes.warn(_log, error.cause, error, time.monotonic())
            if event is None or time.monotonic() >= (self._places_until_s or math.inf):
                self._publish_all_places()
            self._every_second()
            state, bond, held = (
                self.services.lifecycle.state,
                self._bond.instance_id,
                self._amcl.held,
            )
            self._file.keep(Doing(state=state, bond=bond, held=held), time.monotonic())

    def _resume(self, before: Doing) -> None:
        """Continue in the state of a killed bridge; the coordinator still knows the pose."""
        _log.info("%s again, the state of the bridge that was killed", before.state.label)
        self.services.lifecycle.state = before.state
        if before.state is State.ACTIVE:
            self._amcl.resume(before.held)
            self._bond.begin(before.bond)
            self._do([NoMotionUpdate()])  # otherwise a standing robot gets no belief

    def _on_event(self, event: InboxEvent | None) -> None:
        match event:
            case None:
                self._do(self._amcl.on_tick(time.monotonic_ns()))
            case FromRos():
                self._on_message(event)
            case Called():
                self._on_call(event)
            case Asked():
                self._link.answer(event)
            case Received(key=keys.BELIEF):
                self._do(self._amcl.on_belief(decode_ours(event.payload, Belief)))
                if self._places_until_s is None:
                    self._places_until_s = time.monotonic() + _PLACES_WITHIN_S
            case Received(key=keys.STATUS):
                self._status = decode_ours(event.payload, Status)
                self.services.freshness = self._status.freshness
                self._do(self.services.on_live_settings(self._status.settings))
            case Received():
                self._on_report(event)
            case Answered(received=received):
                if problem := decode_ours(received.payload, CommandDone).problem:
                    self._refused(Refused("command refused", f"{received.key}: {problem}"))
            case Unanswered(key=keys.STATUS):
                self._status, self.services.freshness = None, "unreachable"
            case Unanswered(key=key, words=words):
                problem = words or "no answer"
                self._refused(Refused("command not carried out", f"{key}: {problem}"))

    def _publish_all_places(self) -> None:
        if self._places_until_s is not None:
            self._places_until_s = None
            self._do(self._amcl.all_places())

    def _on_message(self, event: FromRos) -> None:
        if event.problem:
            self._refused(Refused("not a ROS message", f"{event.topic.name}: {event.problem}"))
            return
        message = decode(event.payload, event.topic.ros_type)
        amcl, now_ns = self._amcl, time.monotonic_ns()
        match event.topic:
            case topic if topic in self._topics.scans:
                self._do(amcl.on_scan(message, now_ns))
            case self._topics.tf:
                self._do(amcl.on_transforms(message, now_ns, fixed=False))
            case self._topics.tf_static:
                self._do(amcl.on_transforms(message, now_ns, fixed=True))
            case self._topics.map:
                self._do(amcl.on_map(message))
            case topics.INITIAL_POSE:
                self._do(amcl.on_initial_pose(message))
            case topics.CLOCK:
                self._do(amcl.on_clock(message))

    def _on_call(self, call: Called) -> None:
        ros_type = self.services.types()[call.service]
        try:
            if call.problem:
                raise MalformedMessageError(expected="ROS service call", problem=call.problem)
            request = decode(call.payload, request_of(ros_type))
        except MalformedMessageError:
            call.drop()
            raise
        response, outputs = self.services.call(call.service, request)
        call.respond(encode(response, response_of(ros_type)))
        self._do(outputs)

    def _on_report(self, event: Received) -> None:
        report: Report = decode_ours(event.payload, Report)  # type: ignore[arg-type] # a union
        if isinstance(report, TrackReport) and report.snapshot is not None:
            cluster = report.job_id.removeprefix(_CLUSTER)
            if cluster.isdecimal():
                self._amcl.on_particles(int(cluster), report.snapshot)

    def _do(self, outputs: Iterable[Output]) -> None:
        for output in outputs:
            match output:
                case Publish(topic=topic, message=message):
                    self._publishers[topic.name].put(message)
                case Refused():
                    self._refused(output)
                case Bond(alive=True):
                    self._bond.begin()
                case Bond():
                    self._bond.end()
                case GiveMap():
                    self._link.give_map(output)
                case GivePose() | SearchEverywhere() | NoMotionUpdate() | Reconfigure():
                    self._link.command(
                        output,
                        lambda answer: self._inbox.put_own(Answered(answer)),
                        lambda key, words: self._inbox.put_own(Unanswered(key, words)),
                    )
                case reading:
                    self._link.put(reading)

    def _refused(self, refused: Refused) -> None:
        self._causes.warn(_log, refused.cause, refused.detail, time.monotonic())

    def _every_second(self) -> None:
        now_s = time.monotonic()
        if now_s < self._next_status_s:
            return
        self._next_status_s = now_s + _STATUS_EVERY_S
        key = keys.STATUS
        put = self._inbox.put_own
        self._link.ask(key, put, lambda words: put(Unanswered(key, words)))
        self._publishers[topics.DIAGNOSTICS.name].put(self._diagnostics())

    def _diagnostics(self) -> object:
        status, belief = self._status, self._amcl.belief
        values: dict[str, object] = {"life cycle": self.services.lifecycle.state.label}
        if belief is not None and belief.hypotheses:
            values["places"] = len(belief.hypotheses)
            values["probability"] = f"{belief.hypotheses[0].probability:.3f}"
        if belief is not None:
            values["probability elsewhere"] = f"{belief.elsewhere_probability:.3f}"
            values["probability off the map"] = f"{belief.off_map_probability:.3f}"
        if status is not None:
            values |= {"step": status.step, "workers": len(status.workers)}
        values |= self._causes.total | {
            f"dropped {what}": count for what, count in self._inbox.dropped().items()
        }
        state = status.state if status is not None else "searching"
        node_name = self._settings.ros2.node_name
        return diagnostics(state, self.services.freshness, values, node_name, self._clock_ns())

    def _clock_ns(self) -> int:
        if self._settings.ros2.use_sim_time:
            return self._amcl.clock_ns or 0
        return time.time_ns()
