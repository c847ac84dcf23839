"""The rim of the page: messages of one robot's system in, frames for browsers out."""

import logging
import time
import uuid
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any, TypeAlias

import zenoh

from live_view.commands import DriveRobot, ShowEarlier, ShowPast, message_of
from live_view.map_reduction import reduced
from live_view.particle_clouds import may_have_particles
from live_view.picture import Picture
from live_view.room import Browser, Commanded, FromBrowser, Joined, Questioned, Room
from live_view.step_latency import StepLatency
from process_runtime.settings import Settings
from process_runtime.stop import StopFlag
from protocol import keys
from protocol.answers import Belief, CommandDone, Hypotheses, PoseAnswer, Status
from protocol.codec import decode
from protocol.errors import MalformedMessageError, UnreachableError
from protocol.job_events import JobEvents
from protocol.steps import MapMessage, Scan, TruePose
from protocol.work import TrackReport
from zenoh_link.inbox import Inbox
from zenoh_link.session import open_session
from zenoh_link.wire import Event, Link, Received, Unread, ask_later, subscribe, watch_link

_log = logging.getLogger(__name__)

_HEARD = (keys.BELIEF, keys.EVENTS)
_LOOKED_AT = (keys.TRUTH, keys.POSE)
"""These wake nobody, nor do scans: they are drawn with the belief of their step, or soon after."""
_KEPT_MESSAGES = 64
_REPORTS_EVERY_S = 0.2
_POLL_S = 0.1
_AT_ONCE = 64
_CONNECT_WITHIN_S = 0.5
"""Browsers wait so long for an answer while there is no router; a busy one needs some of it."""
_STATUS_EVERY_S = 1.0
_UNANSWERED_ENOUGH = 2
"""A busy system may miss one question."""
_MAP_TIMEOUT_S = 30.0
_COMMAND_TIMEOUT_S = 5.0


class _Unanswered:
    """Nobody answered a question, or a command; then the page it came from."""

    def __init__(self, key: str, words: str, browser: Browser | None = None) -> None:
        self.key, self.words, self.browser = key, words, browser


class _Answered:
    """A command was answered."""

    def __init__(self, received: Received, commanded: Commanded) -> None:
        self.received, self.commanded = received, commanded


_InboxEvent: TypeAlias = Event | FromBrowser | _Unanswered | _Answered


def answer_browser(room: Room, picture: Picture, asked: Joined | Questioned) -> None:
    """Give one page what it wants to know."""
    match asked:
        case Joined(browser):
            room.tell(browser, picture.everything())
        case Questioned(browser, ShowPast(step)):
            room.tell(browser, {"past": picture.past(step)})
        case Questioned(browser, ShowEarlier(before)):
            room.tell(browser, {"earlier": picture.rows_before(before)})


class LiveLoop:
    """Takes from the inbox, and owns the picture: there is no lock.

    Args:
        settings: the router's endpoint and the robot's name.
        about: what pages are told once, besides: whether they may command, other robots.
    """

    def __init__(self, settings: Settings, about: Mapping[str, Any]) -> None:
        self._settings = settings
        self._inbox: Inbox[_InboxEvent] = Inbox(dict.fromkeys(_HEARD, _KEPT_MESSAGES))
        self._scans: Inbox[Event] = Inbox({keys.SCAN: _KEPT_MESSAGES})
        """With the times when they arrived; nobody waits for them."""
        self._latency = StepLatency()
        self.room = Room(settings.robot.name, self._inbox.put)
        self.picture = Picture(
            {"robot": settings.robot.name, "router": settings.zenoh.router, **about}
        )
        self.map: MapMessage | None = None
        """Small enough for a browser."""
        self._session: zenoh.Session | None = None
        self._unread: dict[str, Unread] = {}
        self._next_status_s = self._next_reports_s = 0.0
        self._asking_map, self._unanswered = False, 0
        self._has_link = False
        self._has_warned = False

    def run(self, stop: StopFlag) -> None:
        """Look for the router, and hear the system, until told to stop."""
        with ExitStack() as resources:
            while not stop.is_set():
                self.turn(stop, resources)

    def turn(self, stop: StopFlag, resources: ExitStack) -> None:
        """Hear what has come, or wait a moment for it.

        Args:
            stop: looked at while the router is looked for.
            resources: hold the session, once there is one.
        """
        if self._session is None:
            self._session = self._connected(stop, resources)
        self._ask_what_is_due()
        self._hear(_POLL_S)
        self._look_at(*_LOOKED_AT)
        self._look_at_reports()
        if changes := self.picture.changes():
            self.room.publish(changes)

    def _connected(self, stop: StopFlag, resources: ExitStack) -> zenoh.Session | None:
        """A session that hears everything; None: there is no router yet."""
        settings = self._settings
        try:
            opened = open_session(settings.zenoh, settings.robot, stop, wait_s=_CONNECT_WITHIN_S)
            session = resources.enter_context(opened)
        except UnreachableError as error:
            _log.debug("%s", error)
            return None
        for key in _HEARD:
            subscribe(session, key, self._inbox, key)
        subscribe(session, keys.SCAN, self._scans, keys.SCAN)
        self._unread = {
            key: Unread(session, key, self._inbox, key, _KEPT_MESSAGES)
            for key in (*_LOOKED_AT, keys.ALL_REPORTS)
        }
        watch_link(session, self._inbox)
        return session

    def _hear(self, timeout_s: float) -> None:
        """Take what has come, so that all of it is one picture; wait for the first."""
        event = self._inbox.get(timeout_s)
        left = _AT_ONCE
        while event is not None:
            try:
                self._on_event(event)
            except MalformedMessageError as error:
                self._on_malformed(error)
            left -= 1
            event = self._inbox.get(0.0) if left else None

    def _look_at_reports(self) -> None:
        """Take the particles out of what workers have reported."""
        now_s = time.monotonic()
        if now_s >= self._next_reports_s:
            self._next_reports_s = now_s + _REPORTS_EVERY_S
            self._look_at(keys.ALL_REPORTS)

    def _look_at(self, *looked_at: str) -> None:
        """Take what has come on keys that wake nobody."""
        for key in looked_at:
            for payload in self._unread[key].drain() if key in self._unread else ():
                try:
                    self._on_payload(key, payload)
                except MalformedMessageError as error:
                    self._on_malformed(error)

    def _look_at_scans(self) -> None:
        """Take the scans that have come."""
        while isinstance(event := self._scans.get(0.0), Received):
            try:
                scan = decode(event.payload, Scan)
            except MalformedMessageError as error:
                self._on_malformed(error)
                continue
            self._latency.on_scan(scan.step, event.at_ns)
            self.picture.on_scan(scan)

    def _on_malformed(self, error: MalformedMessageError) -> None:
        """Say the first; a stranger shall not fill the log."""
        if not self._has_warned:
            self._has_warned = True
            _log.warning("ignored, as all that follow: %s", error)

    def _on_event(self, event: _InboxEvent) -> None:
        match event:
            case Joined() | Questioned():
                answer_browser(self.room, self.picture, event)
            case Commanded():
                self._command(event)
            case _Answered(received=received, commanded=commanded):
                problem = decode(received.payload, CommandDone).problem
                if problem or not isinstance(commanded.command, DriveRobot):
                    self.room.tell(commanded.browser, {"done": {"problem": problem}})
            case _Unanswered():
                self._on_unanswered(event)
            case Link(up):
                self._has_link = up
                self.picture.on_link("no system" if up else "no router")
                self._next_status_s = 0.0
            case Received(key=keys.BELIEF):
                self._on_belief(event)
            case Received():
                self._on_payload(event.key, event.payload)

    def _on_belief(self, received: Received) -> None:
        self._look_at_scans()
        self._look_at(keys.TRUTH)
        belief = decode(received.payload, Belief)
        self._latency.on_belief(belief.step, received.at_ns)
        self.picture.on_belief(belief)

    def _on_payload(self, key: str, payload: bytes) -> None:
        picture = self.picture
        match key:
            case keys.ALL_REPORTS:
                if may_have_particles(payload):
                    picture.on_report(decode(payload, TrackReport))
            case keys.POSE:
                picture.on_pose(decode(payload, PoseAnswer))
            case keys.TRUTH:
                picture.on_truth(decode(payload, TruePose))
            case keys.EVENTS:
                if not picture.on_events(decode(payload, JobEvents)):
                    self._ask(keys.EVENTS)
            case keys.STATUS if self._has_link:  # an answer may come after its router has gone
                was = picture.link
                picture.on_status(decode(payload, Status), self._latency.frame())
                self._unanswered = 0
                if was != "running":
                    self._ask(keys.EVENTS)
                    self._ask(keys.POSE)
            case keys.HYPOTHESES:
                picture.on_belief(_belief_of(decode(payload, Hypotheses)))
            case keys.MAP:
                self._asking_map = False
                message = reduced(decode(payload, MapMessage))
                self.map = message
                self.room.set_map(message.digest, message.zlib_cells)
                picture.on_map(message)

    def _on_unanswered(self, event: _Unanswered) -> None:
        match event.key:
            case keys.STATUS if self.picture.link == "running":
                self._unanswered += 1
                if self._unanswered >= _UNANSWERED_ENOUGH:
                    self.picture.on_link("no system")
            case keys.MAP:
                self._asking_map = False
        if event.browser is not None:
            problem = event.words or "nobody answers: the system is not running"
            self.room.tell(event.browser, {"done": {"problem": problem}})

    def _ask_what_is_due(self) -> None:
        now_s = time.monotonic()
        if self._session is None or now_s < self._next_status_s:
            return
        self._next_status_s = now_s + _STATUS_EVERY_S
        self._ask(keys.STATUS)
        if not self.picture.has_wanted_map and not self._asking_map:
            self._asking_map = True
            self._ask(keys.MAP, _MAP_TIMEOUT_S)

    def _ask(self, key: str, timeout_s: float | None = None) -> None:
        if self._session is not None:
            ask_later(
                self._session,
                key,
                self._inbox.put_own,
                lambda words: self._inbox.put_own(_Unanswered(key, words)),
                timeout_s=timeout_s or self._settings.zenoh.query_timeout_s,
            )

    def ask_for_places(self) -> None:
        """Have the places shown where they are now: a robot that stands publishes no step."""
        self._ask(keys.HYPOTHESES)

    def _command(self, commanded: Commanded) -> None:
        browser = commanded.browser
        key, message = message_of(commanded.command, "live_view", uuid.uuid4().hex)
        if self._session is None:
            self._inbox.put_own(_Unanswered(key, "", browser))
            return
        ask_later(
            self._session,
            key,
            lambda received: self._inbox.put_own(_Answered(received, commanded)),
            lambda words: self._inbox.put_own(_Unanswered(key, words, browser)),
            timeout_s=_COMMAND_TIMEOUT_S,
            message=message,
        )


def _belief_of(answer: Hypotheses) -> Belief:
    """The places of now as those of a step, without what only a step has."""
    return Belief(
        sender=answer.sender,
        step=answer.pose.step,
        stamp_ns=answer.pose.stamp_ns,
        odom_from_robot=(0.0, 0.0, 0.0),
        state=answer.pose.state,
        hypotheses=answer.hypotheses,
        searching=False,
        term=answer.pose.term,
    )
