"""Messages over a Zenoh session: publish, ask, and put what arrives into an inbox.

Callbacks only put: a callback that computes or waits stalls every other subscription and query
of its session. Decoding happens in the loop that takes from the inbox.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeAlias, TypeVar

import zenoh
from zenoh import handlers

from process_runtime.latency_trace import mark
from protocol.codec import decode, encode
from protocol.errors import RefusedError, UnreachableError
from protocol.limits import max_bytes_on
from protocol.message import Message
from zenoh_link.inbox import Inbox

ENCODING = "application/msgpack"

M = TypeVar("M")


AS_THEY_COME = zenoh.ConsolidationMode.NONE
"""Answers; else the first one is held back until all who serve have answered."""


@dataclass(frozen=True)
class Received:
    """A message that was published, still undecoded."""

    key: str
    payload: bytes
    at_ns: int = 0
    """When it arrived, by the monotonic clock; 0 for an answer."""


@dataclass(frozen=True)
class Asked:
    """A query that waits for its answer."""

    key: str
    payload: bytes
    query: zenoh.Query

    def answer(self, message: Message) -> None:
        """Answer and close the query."""
        with self.query:
            self.query.reply(self.query.key_expr, encode(message), encoding=ENCODING)

    def refuse(self, problem: str) -> None:
        """Answer with an error and close the query."""
        with self.query:
            self.query.reply_err(problem.encode(), encoding="text/plain")


@dataclass(frozen=True)
class Token:
    """A liveliness token appeared or vanished."""

    key: str
    alive: bool


@dataclass(frozen=True)
class Link:
    """This process's own link to the router came up or was lost.

    Zenoh reports all tokens as vanished just *before* it reports its own link as lost.
    """

    up: bool


Event: TypeAlias = Received | Asked | Token | Link
Events: TypeAlias = Inbox[Event]


class EventSink(Protocol):
    """What callbacks put into: an inbox, whatever else its loop takes from it."""

    def put(self, event: Event) -> bool:
        """Append; False: there is no room."""

    def put_own(self, event: Event) -> None:
        """Append what this process sends to itself."""

    def put_newest(self, kind: str, state: Event) -> None:
        """Append a state; the oldest of its kind gives way when there are too many."""

    def count_refused(self, kind: str) -> None:
        """Count what was too large."""


class Publisher:
    """Publishes messages on one key.

    Args:
        session: the process's own.
        key: where.
        may_wait: wait for a slow link, as large messages must; else drop the message.
    """

    def __init__(self, session: zenoh.Session, key: str, *, may_wait: bool = False) -> None:
        wait, drop = zenoh.CongestionControl.BLOCK, zenoh.CongestionControl.DROP
        self._publisher = session.declare_publisher(
            key,
            encoding=ENCODING,
            congestion_control=wait if may_wait else drop,
            priority=zenoh.Priority.DATA_HIGH,
            express=True,
        )

    def put(self, message: Message) -> None:
        """Publish."""
        mark("encode", message)
        data = encode(message)
        mark("put", message)
        self._publisher.put(data)
        mark("gone", message)


def subscribe(
    session: zenoh.Session, key: str, inbox: EventSink, kind: str, *, own: bool = True
) -> None:
    """Put what is published on `key` into the inbox, as states of a kind.

    Args:
        session: the process's own.
        key: or an expression that stands for several.
        inbox: woken by each message.
        kind: as the inbox was made for.
        own: also what this very session publishes.
    """

    def on_sample(sample: zenoh.Sample) -> None:
        name = str(sample.key_expr)
        if len(sample.payload) > max_bytes_on(name):
            inbox.count_refused(kind)
        else:
            received = Received(name, sample.payload.to_bytes(), time.monotonic_ns())
            inbox.put_newest(kind, received)

    origin = zenoh.Locality.ANY if own else zenoh.Locality.REMOTE
    session.declare_subscriber(key, on_sample, allowed_origin=origin)


class Unread:
    """The newest messages on a key, for who looks now and then: they wake nobody.

    Waking a thread costs more than most messages take to read.

    Args:
        session: the process's own.
        key: of the messages.
        inbox: counts what is too large.
        kind: what to count it as.
        count: so many are kept; the oldest gives way.
    """

    def __init__(
        self, session: zenoh.Session, key: str, inbox: EventSink, kind: str, count: int
    ) -> None:
        self._subscriber = session.declare_subscriber(key, handlers.RingChannel(count))
        self._inbox, self._kind = inbox, kind

    def drain(self) -> Iterator[bytes]:
        """The payloads that arrived since the last look, oldest first."""
        while (sample := self._subscriber.try_recv()) is not None:
            if len(sample.payload) > max_bytes_on(str(sample.key_expr)):
                self._inbox.count_refused(self._kind)
            else:
                yield sample.payload.to_bytes()


def serve(session: zenoh.Session, key: str, inbox: EventSink) -> None:
    """Put queries on `key` into the inbox; one that finds it full is refused at once.

    Never declared complete: of several that are, a router asks one, and that one may hear nothing.
    """

    def on_query(query: zenoh.Query) -> None:
        name, payload = str(query.key_expr), b""
        if query.payload is not None:
            if len(query.payload) > max_bytes_on(name):
                inbox.count_refused("query")
                Asked(name, b"", query).refuse("too large")
                return
            payload = query.payload.to_bytes()
        asked = Asked(name, payload, query)
        if not inbox.put(asked):
            asked.refuse("too busy; ask again")

    session.declare_queryable(key, on_query)


def watch(session: zenoh.Session, key: str, inbox: EventSink) -> None:
    """Put liveliness tokens on `key` into the inbox, those there already first."""

    def on_token(sample: zenoh.Sample) -> None:
        inbox.put(Token(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT))

    session.liveliness().declare_subscriber(key, on_token, history=True)


def watch_link(session: zenoh.Session, inbox: EventSink) -> None:
    """Put what happens to this session's own link into the inbox, that it is up first."""

    def on_transport(event: zenoh.TransportEvent) -> None:
        inbox.put_own(Link(event.kind == zenoh.SampleKind.PUT))

    session.info.declare_transport_events_listener(on_transport, history=True)


def is_alive(session: zenoh.Session, key: str, timeout_s: float) -> bool:
    """Whether a liveliness token is there."""
    return bool(alive(session, key, timeout_s))


def alive(session: zenoh.Session, key: str, timeout_s: float) -> list[str]:
    """The liveliness tokens that are there."""
    replies = session.liveliness().get(key, timeout=timeout_s)
    return sorted(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)


def ask(
    session: zenoh.Session,
    key: str,
    answer: type[M],
    *,
    timeout_s: float,
    message: Message | None = None,
) -> M:
    """Ask whoever serves `key` and take the first answer.

    Raises:
        RefusedError: nobody answered in time but with a refusal.
        UnreachableError: nobody answered in time at all.
        MalformedMessageError: the answer is not the message it should be.
    """
    payload = encode(message) if message is not None else None
    error: type[UnreachableError] = UnreachableError
    problem = f"nobody answers on {key!r}"
    for reply in session.get(key, payload=payload, consolidation=AS_THEY_COME, timeout=timeout_s):
        if reply.ok is not None:
            return decode(reply.ok.payload.to_bytes(), answer)
        if reply.err is not None:
            said = reply.err.payload.to_bytes().decode(errors="replace")
            error, problem = RefusedError, f"no answer on {key!r}: {said}"
    raise error(who=key, problem=problem, waited_s=timeout_s)


def ask_later(
    session: zenoh.Session,
    selector: str,
    on_answer: Callable[[Received], object],
    on_failure: Callable[[str], object],
    *,
    timeout_s: float,
    message: Message | None = None,
) -> None:
    """Ask without waiting. One of the two is called, on a thread of Zenoh's: put, and return.

    Args:
        session: the process's own.
        selector: of what is asked.
        on_answer: takes the first answer, undecoded.
        on_failure: takes the words of who refused, or was too late; empty: nobody was there.
        timeout_s: how long somebody may take to answer.
        message: what is asked.
    """
    answered, refused = False, ""

    def on_reply(reply: zenoh.Reply) -> None:
        nonlocal answered, refused
        if reply.err is not None:
            refused = reply.err.payload.to_bytes().decode(errors="replace")
        if reply.ok is not None and not answered:
            answered = True
            on_answer(Received(str(reply.ok.key_expr), reply.ok.payload.to_bytes()))

    session.get(
        selector,
        handlers.Callback(on_reply, lambda: None if answered else on_failure(refused)),
        payload=encode(message) if message is not None else None,
        consolidation=AS_THEY_COME,
        timeout=timeout_s,
    )
