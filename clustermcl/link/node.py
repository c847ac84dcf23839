"""A process's connection to Zenoh: a session, an inbox, and the loop that handles its events."""

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import zenoh

from clustermcl.link import wire
from clustermcl.link.access_control import doubt_of_certificate
from clustermcl.link.health import HealthReporter
from clustermcl.link.inbox import Inbox
from clustermcl.link.session import open_session, refusal
from clustermcl.link.stale_session import STALE, StaleSessionDetector
from clustermcl.protocol.causes import AnyCause
from clustermcl.protocol.codec import decode
from clustermcl.protocol.errors import MalformedMessageError, UnreachableError
from clustermcl.protocol.message import SMALL_BYTES, Message
from clustermcl.runtime.logs import CauseCounter
from clustermcl.runtime.memory import SETTLED_S, trim_heap
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.stop import StopFlag

LOOK_S = 1.0
"""Time-out of opening another session, and of looking for peers through it [s]."""
ASK_WHY_AFTER_S, ASK_WHY_EVERY_S = 3.0, 60.0
"""A lost link is diagnosed after this time, and again after each of the other [s]."""
ROLES = {"page": ("viewer", "operator"), "ros2": ("ros2",)}
"""Roles of certificates for processes that are not called after theirs."""
REPEAT_S = 0.01
"""Longest turn while a query has to be repeated [s]."""

_log = logging.getLogger(__name__)

M = TypeVar("M", bound=Message)
T = TypeVar("T")


@dataclass(frozen=True)
class Call:
    """A function to call in the loop, requested by another thread or for a peer's reply."""

    act: Callable[[], object]
    from_peer: bool = False


class Subscription:
    """Receives what is published on a key, except while it is paused."""

    def __init__(
        self, subscribe: Callable[[zenoh.Session], zenoh.Subscriber[None]], *, paused: bool
    ) -> None:
        self._subscribe, self._paused = subscribe, paused
        self._session: zenoh.Session | None = None
        self._subscriber: zenoh.Subscriber[None] | None = None

    def declare(self, session: zenoh.Session) -> None:
        self._session = session
        self._subscriber = None if self._paused else self._subscribe(session)

    def pause(self, paused: bool) -> None:
        """Receive nothing until `pause(False)`, so that no message wakes this process."""
        if paused == self._paused:
            return
        self._paused = paused
        if self._subscriber is not None:
            self._subscriber.undeclare()  # type: ignore[no-untyped-call] # the stub's
        if self._session is not None:
            self.declare(self._session)


class Node:
    """A process's connection to Zenoh: receives, dispatches to handlers, publishes and queries.

    All handlers run in the one loop that calls `turn`, so there are no locks. A malformed message
    is counted and logged; a malformed query is refused as well.

    When a session is stale (see `StaleSessionDetector`), a new session that sees peers replaces
    it. The node repeats all declarations in the new session, and the process keeps its state.

    Args:
        peers: key of liveliness tokens that prove that a session works; None: no session of this
            process is ever replaced.
        session: a session that other nodes share, and that outlives them; None: open one.
    """

    def __init__(
        self,
        name: str,
        role: str,
        settings: Settings,
        stop: StopFlag,
        *,
        peers: str | None,
        session: zenoh.Session | None = None,
    ) -> None:
        self.name, self.stop, self.robot = name, stop, settings.robot.name
        self.inbox: Inbox[Any] = Inbox({})
        self._causes = CauseCounter()
        self.health = HealthReporter(name, role, self._causes, self.inbox)
        self._trim_heap_s = math.inf
        self.on_other: Callable[[Any], object] = lambda _event: None
        """Handler of events that other parts of the process put into the inbox."""
        self._settings, self.peers, self._shared = settings, peers, session
        self._session: zenoh.Session | None = None
        self._opened = ExitStack()
        self._stale = StaleSessionDetector()
        self._declarations: list[Callable[[zenoh.Session], object]] = []
        self._tokens: list[zenoh.LivelinessToken] = []
        self._on_received: dict[str, Callable[[wire.Received], object]] = {}
        self._on_asked: dict[str, Callable[[wire.Asked], object]] = {}
        self._on_token: Callable[[wire.Token], object] = self.on_other
        self._on_link: Callable[[wire.Link], object] = self.on_other
        self._health_publisher: wire.Publisher | None = None
        self._unanswered: deque[Callable[[], None]] = deque()
        self._ask_why_s: float | None = None
        """When to find out why there is no link [s]; None: there is one."""
        if session is None:  # the links of a shared one are those of its clients
            self.declare(lambda session: wire.watch_link(session, self.inbox))

    def open(self, wait_s: float | None = None) -> zenoh.Session:
        """Connect to the router and declare everything; `wait_s` and errors as `open_session`."""
        with ExitStack() as opening:
            session = self._opened_in(opening, wait_s)
            self._use(session, opening.pop_all())
        if self._shared is None and (certificate := self._settings.zenoh.tls_certificate):
            roles = ROLES.get(self.health.role, (self.health.role,))
            if doubt := doubt_of_certificate(certificate, roles, self.name, self.robot):
                why = "a router with access control drops the messages of this process"
                _log.warning("%s: %s; %s", certificate, doubt, why)
        return session

    def _opened_in(self, stack: ExitStack, wait_s: float | None) -> zenoh.Session:
        if self._shared is not None:
            return self._shared
        settings = self._settings
        return stack.enter_context(open_session(settings.zenoh, settings.robot, self.stop, wait_s))

    def close(self) -> None:
        self._opened.close()

    @property
    def session(self) -> zenoh.Session:
        """The present session, for what a node has no method for; see also `is_open`."""
        assert self._session is not None  # `open` was called
        return self._session

    @property
    def is_open(self) -> bool:
        return self._session is not None

    # --- declarations

    def declare(self, declaration: Callable[[zenoh.Session], object]) -> None:
        """Declare something through the session, and again through each that replaces it."""
        self._declarations.append(declaration)
        if self._session is not None:
            declaration(self._session)

    def subscribe(
        self,
        key: str,
        message: type[M],
        handler: Callable[[M, wire.Received], object],
        *,
        kind: str,
        kept: int,
        own: bool = True,
        paused: bool = False,
    ) -> Subscription:
        """Call `handler` with each message on `key`, decoded and as received.

        `kept` messages of its `kind` are queued. `own`: also what this process publishes.
        """

        def on_received(received: wire.Received) -> None:
            handler(decode(received.payload, message), received)

        self.inbox.keep(kind, kept)
        self._on_received[kind] = on_received
        subscription = Subscription(
            lambda session: wire.subscribe(session, key, message, self.inbox, kind, own=own),
            paused=paused,
        )
        self.declare(subscription.declare)
        return subscription

    def poll(self, key: str, message: Any, kind: str, kept: int) -> wire.Unread:
        """Keep the newest messages on `key` without waking the loop; arguments as `subscribe`."""
        unread = wire.Unread(key, message, self.inbox, kind, kept)
        self.declare(unread.declare)
        return unread

    def drain(self, unread: wire.Unread, handler: Callable[[bytes], object]) -> None:
        """Call `handler` with each payload that was received since the last call."""
        for payload in unread.drain():
            self._stale.on_event(payload, time.monotonic_ns())
            self.attempt(handler, payload)

    def serve(
        self, key: str, handler: Callable[[wire.Asked], object], limit_bytes: int = SMALL_BYTES
    ) -> None:
        """Call `handler` with each query on `key`; it answers, or raises before it answers."""
        self._on_asked[key] = handler
        self.declare(lambda session: wire.serve(session, key, self.inbox, limit_bytes))

    def watch(self, key: str, handler: Callable[[wire.Token], object]) -> None:
        self._on_token = handler
        self.declare(lambda session: wire.watch(session, key, self.inbox))

    def watch_link(self, handler: Callable[[wire.Link], object]) -> None:
        self._on_link = handler

    def announce(self, key: str) -> None:
        """Declare a liveliness token, which ends with the session."""
        self.declare(lambda session: self._tokens.append(session.liveliness().declare_token(key)))

    def publisher(self, key: str, *, may_wait: bool = False) -> wire.Publisher:
        publisher = wire.Publisher(None, key, may_wait=may_wait)
        self.declare(publisher.declare)
        return publisher

    def publish_health(self, key: str) -> None:
        self._health_publisher = self.publisher(key)

    # --- queries, and work in the background

    def ask(
        self,
        selector: str,
        answer: type[M],
        on_answer: Callable[[M], object],
        on_failure: Callable[[str], object] = lambda _problem: None,
        *,
        timeout_s: float,
        message: Message | None = None,
        repeat_for_s: float = 0.0,
    ) -> None:
        """Query without blocking; one of two functions is called in a later turn.

        `on_failure` takes the reason; empty: no process answered. A failed query is repeated for
        `repeat_for_s` [s]: just after a link came up, it may find no queryable yet.
        """
        until_s = time.monotonic() + repeat_for_s

        def query() -> None:
            if self._session is None:
                failed("")
                return
            wire.ask_later(
                self._session, selector, answered, failed, timeout_s=timeout_s, message=message
            )

        def answered(received: wire.Received) -> None:
            self.inbox.put_own(Call(partial(take, received), from_peer=True))

        def take(received: wire.Received) -> None:
            try:
                decoded = decode(received.payload, answer)
            except MalformedMessageError as error:
                on_failure(str(error))
                raise
            on_answer(decoded)

        def failed(problem: str) -> None:
            if time.monotonic() < until_s:
                self._unanswered.append(query)
            else:
                self.inbox.put_own(Call(partial(on_failure, problem), from_peer=problem != ""))

        query()

    def in_background(self, work: Callable[[], T], on_done: Callable[[Future[T]], object]) -> None:
        """Run `work` in a separate thread; call `on_done` in a later turn."""
        future: Future[T] = Future()

        def run() -> None:
            try:
                future.set_result(work())
            except Exception as error:  # noqa: BLE001 - raised again in the loop, by `result`
                future.set_exception(error)
            self.inbox.put_own(Call(partial(on_done, future)))

        # A daemon: a stopped process does not wait for a large map.
        threading.Thread(target=run, name="background", daemon=True).start()

    # --- the loop

    def turn(self, wait_s: float) -> object:
        """Handle the oldest event of the inbox, and do what is due.

        Return the event; None: there was none within `wait_s`.
        """
        event = self.inbox.get(min(wait_s, REPEAT_S) if self._unanswered else wait_s)
        self.attempt(self._handle, event)
        if event is None and time.monotonic() >= self._trim_heap_s:
            self._trim_heap_s = math.inf
            trim_heap()
        for _ in range(len(self._unanswered)):
            self._unanswered.popleft()()
        if self._ask_why_s is not None and time.monotonic() >= self._ask_why_s:
            self._ask_why_s = time.monotonic() + ASK_WHY_EVERY_S
            self.in_background(partial(refusal, self._settings.zenoh), self._on_refusal)
        if self._stale.is_suspect(time.monotonic_ns()):
            self._replace_session()
        if self._health_publisher is not None:
            self.health.publish_if_due(self._health_publisher)
        return event

    def trim_heap_soon(self) -> None:
        """Trim the heap after a large message, such as those of a take-over, has been freed."""
        self._trim_heap_s = time.monotonic() + SETTLED_S

    def _on_refusal(self, asked: Future[str | None]) -> None:
        if self._ask_why_s is not None and (problem := asked.result()):
            _log.warning("%s", problem)

    def attempt(self, handler: Callable[[T], object], event: T) -> None:
        """Call a handler; count and log a malformed message, and refuse a malformed query."""
        try:
            handler(event)
        except MalformedMessageError as error:
            if isinstance(event, wire.Asked):
                event.refuse(str(error))
            self.warn(_log, error.cause, error)

    def warn(self, log: logging.Logger, cause: AnyCause, detail: object) -> None:
        """Count one fault in the health, and log each cause at most once a minute."""
        self._causes.warn(log, cause, detail, time.monotonic())

    def _handle(self, event: object) -> None:
        if isinstance(event, wire.Event) or (isinstance(event, Call) and event.from_peer):
            self._stale.on_event(event, time.monotonic_ns())
        match event:
            case None:
                pass
            case wire.Received(kind=kind):
                self._on_received[kind](event)
            case wire.Asked(key=key):
                self._on_asked[key](event)
            case wire.Token():
                self._on_token(event)
            case wire.Link(up=up):
                self._ask_why_s = None if up else time.monotonic() + ASK_WHY_AFTER_S
                self._on_link(event)
            case Call():
                event.act()
            case _:
                self.on_other(event)

    def replace_stale_session(self) -> bool:
        """Replace a session that is silent since its link came back, if another one sees peers."""
        return self._stale.is_armed and self._replace_session()

    def _replace_session(self) -> bool:
        """Open another session; keep it if it sees peers."""
        with ExitStack() as opening, suppress(UnreachableError):
            if self.peers is not None:
                session = self._opened_in(opening, LOOK_S)
                if wire.is_alive(session, self.peers, LOOK_S):
                    _log.warning(STALE)
                    self._use(session, opening.pop_all())
                    return True
        return False

    def _use(self, session: zenoh.Session, opened: ExitStack) -> None:
        """Declare everything through a session, and close the one before."""
        before, self._opened, self._session = self._opened, opened, session
        self._tokens.clear()
        before.close()
        self._stale = StaleSessionDetector()
        for declaration in self._declarations:
            declaration(session)
