"""The loop of the page: turns messages of a robot's system into frames for browsers."""

import logging
import time
from contextlib import closing
from functools import partial

import msgspec

from clustermcl.link.node import Node
from clustermcl.link.wire import Link, Received
from clustermcl.protocol import keys
from clustermcl.protocol.advice import Advice
from clustermcl.protocol.answers import Belief, CommandDone, PoseAnswer, Status
from clustermcl.protocol.changes import Changes
from clustermcl.protocol.codec import decode
from clustermcl.protocol.errors import UnreachableError
from clustermcl.protocol.job_events import JobEvents
from clustermcl.protocol.steps import MapMessage, Scan, TruePose
from clustermcl.protocol.work import Reported, TrackReport
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.stop import StopFlag
from clustermcl.view.admission import Address
from clustermcl.view.browser import FromBrowser, PageOpened
from clustermcl.view.commands import AskAdvice, Command, ShowEarlier, ShowPast
from clustermcl.view.frames import Frame
from clustermcl.view.page_server import PageServer
from clustermcl.view.picture import Picture

_log = logging.getLogger(__name__)

_KEPT_MESSAGES = 64
_REPORTS_EVERY_S = 0.2
_POLL_S = 0.1
_EVENTS_PER_PICTURE = 64
_CONNECT_TIMEOUT_S = 0.5
"""Limit for an attempt to connect; browsers get no answer meanwhile [s]."""
_STATUS_EVERY_S = 1.0
_MAX_UNANSWERED = 2
"""Number of consecutive unanswered status queries after which no system seems to run."""
_MAP_TIMEOUT_S = 30.0
_ADVICE_TIMEOUT_S = 20.0
_COMMAND_TIMEOUT_S = 5.0


def answer_browser(server: PageServer, picture: Picture, event: FromBrowser) -> None:
    """Send a page all frames when it joins, or the past steps that it requests."""
    match event.request:
        case PageOpened():
            server.send(event.browser, picture.everything())
        case ShowPast(step):
            server.send(event.browser, {"past": picture.past(step)})
        case ShowEarlier(before):
            server.send(event.browser, {"earlier": picture.rows_before(before)})


class LiveLoop:
    """The loop of one robot's page. No other thread changes the picture, so there is no lock."""

    def __init__(self, settings: Settings, address: Address, about: Frame, stop: StopFlag) -> None:
        name = settings.robot.name
        self.node = Node("view", "page", settings, stop, peers=keys.COORDINATOR_ALIVE)
        self.picture = Picture({"robot": name, "router": settings.zenoh.router, **about})
        self._server = PageServer(
            address, self.picture, self.node.inbox.put, obeys_commands=about["commands"]
        )
        self._next_status_s = self._next_reports_s = 0.0
        self._asking_map, self._unanswered, self._has_link = False, 0, False
        self._ask = partial(self.node.ask, timeout_s=settings.zenoh.query_timeout_s)
        node = self.node
        node.on_other = self._on_browser
        node.watch_link(self._on_link)
        node.subscribe(keys.BELIEF, Belief, self._on_belief, kind=keys.BELIEF, kept=_KEPT_MESSAGES)
        node.subscribe(
            keys.EVENTS, JobEvents, self._on_events, kind=keys.EVENTS, kept=_KEPT_MESSAGES
        )
        on_changes = self.picture.on_changes
        node.subscribe(
            keys.CHANGES, Changes, lambda changes, _: on_changes(changes), kind=keys.CHANGES, kept=1
        )
        # These messages do not wake the loop: they are drawn with a belief, or soon after.
        self._scans, self._reports, self._truth, self._pose = (
            node.poll(key, message, kind=key, kept=_KEPT_MESSAGES)
            for key, message in (
                (keys.SCAN, Scan),
                (keys.ALL_REPORTS, Reported),
                (keys.TRUTH, TruePose),
                (keys.POSE, PoseAnswer),
            )
        )

    def run(self, stop: StopFlag) -> None:
        """Run until `stop` is set, connecting whenever there is no connection."""
        with self._server, closing(self.node):
            while not stop.is_set():
                self.turn()

    def turn(self) -> None:
        """Handle received messages, or wait briefly for one; then send browsers what changed."""
        node = self.node
        if not node.is_open:
            try:
                node.open(_CONNECT_TIMEOUT_S)
            except UnreachableError as error:
                _log.debug("%s", error)
        self._query_status_and_map()
        if node.turn(_POLL_S) is not None:
            for _ in range(_EVENTS_PER_PICTURE - 1):
                if node.turn(0.0) is None:
                    break
        self._draw_waiting()
        node.drain(self._pose, lambda data: self.picture.on_pose(decode(data, PoseAnswer)))
        if (now_s := time.monotonic()) >= self._next_reports_s:
            self._next_reports_s = now_s + _REPORTS_EVERY_S
            node.drain(self._reports, self._on_report)
        if changes := self.picture.changes():
            self._server.publish(changes)

    # --- the system

    def _draw_waiting(self) -> None:
        """Handle received scans and true poses.

        A scan may arrive after its belief, because Zenoh delivers each key in its own thread.
        """
        picture = self.picture
        self.node.drain(self._scans, lambda data: picture.on_scan(decode(data, Scan)))
        self.node.drain(self._truth, lambda data: picture.on_truth(decode(data, TruePose)))

    def _on_belief(self, belief: Belief, _received: Received) -> None:
        self._draw_waiting()
        self.picture.on_belief(belief)

    def _on_report(self, payload: bytes) -> None:
        reported: type[TrackReport] = Reported  # type: ignore[assignment] # a union
        report = decode(payload, reported)
        if isinstance(report, TrackReport) and report.snapshot and report.cluster is not None:
            self.picture.on_particles(report.cluster, report.snapshot)

    def _on_events(self, events: JobEvents, _received: Received | None = None) -> None:
        if not self.picture.on_events(events):
            self._ask_events()

    def _on_link(self, link: Link) -> None:
        self._has_link = link.up
        self.picture.on_link("no system" if link.up else "no router")
        self._next_status_s = 0.0

    def _query_status_and_map(self) -> None:
        now_s = time.monotonic()
        if not self.node.is_open or now_s < self._next_status_s:
            return
        self._next_status_s = now_s + _STATUS_EVERY_S
        self._ask(keys.STATUS, Status, self._on_status, self._on_no_status)
        if not self.picture.has_wanted_map and not self._asking_map:
            self._asking_map = True
            self.node.ask(
                keys.MAP, MapMessage, self._on_map, self._on_no_map, timeout_s=_MAP_TIMEOUT_S
            )

    def _ask_events(self) -> None:
        self._ask(keys.EVENTS, JobEvents, self._on_events)

    def _on_status(self, status: Status) -> None:
        if not self._has_link:
            return  # the link was lost after this answer
        was = self.picture.link
        self.picture.on_status(status)
        self._unanswered = 0
        if was != "running":
            self._ask_events()
            self._ask(keys.POSE, PoseAnswer, self.picture.on_pose)
            self._ask(keys.CHANGES, Changes, self.picture.on_changes)

    def _on_no_status(self, _problem: str) -> None:
        if self.picture.link == "running":
            self._unanswered += 1
            if self._unanswered >= _MAX_UNANSWERED:
                self.picture.on_link("no system")

    def _on_map(self, message: MapMessage) -> None:
        self._asking_map = False
        self.picture.on_map(message)

    def _on_no_map(self, _problem: str) -> None:
        self._asking_map = False

    # --- browsers

    def _on_browser(self, event: FromBrowser) -> None:
        request = event.request

        def send(topic: str, frame: object) -> None:
            self._server.send(event.browser, {topic: frame})

        def on_failure(problem: str) -> None:
            send("done", {"problem": problem or "no answer: the system is not running"})

        def on_done(done: CommandDone) -> None:
            send("done", {"problem": done.problem})

        def on_advice(advice: Advice) -> None:
            send("advice", msgspec.to_builtins(advice))

        if isinstance(request, AskAdvice):
            self.node.ask(keys.ADVICE, Advice, on_advice, on_failure, timeout_s=_ADVICE_TIMEOUT_S)
        elif isinstance(request, Command):
            key, limit_s = request.key, _COMMAND_TIMEOUT_S
            self.node.ask(key, CommandDone, on_done, on_failure, timeout_s=limit_s, message=request)
        else:
            answer_browser(self._server, self.picture, event)
