"""Messages over a Zenoh session: publish, query, and put received messages into an inbox.

Callbacks run on the thread that reads the link, so messages of one process reach the inbox in their
order, and no key costs a thread. They only put: one that computes or blocks stalls the whole
session. The loop that reads the inbox decodes.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

import zenoh
from zenoh import handlers

from clustermcl.link.inbox import Inbox
from clustermcl.protocol.codec import decode, encode, max_bytes
from clustermcl.protocol.errors import RefusedError, UnreachableError
from clustermcl.protocol.message import SMALL_BYTES, Message

ENCODING = "application/msgpack"

M = TypeVar("M")
T = TypeVar("T")

AS_THEY_COME = zenoh.ConsolidationMode.NONE
"""Consolidation of replies; with the default, the first waits until all queryables replied."""
KEPT_TOKENS = 4096
"""Changes of tokens that wait; with more, the loop hangs."""
_TIMED_OUT = "Timeout"
"""Error reply that this process's own session adds to a query without an answer."""


@dataclass(frozen=True)
class Received:
    """A published message, not yet decoded."""

    key: str
    payload: bytes
    at_ns: int = 0
    """Time of arrival on the monotonic clock [ns]; 0 for a reply."""
    kind: str = ""
    """Its kind of state in the inbox; empty for a reply."""


@dataclass(frozen=True)
class Asked:
    """A query that has not been answered."""

    key: str
    """The served key; that of the query may be a wildcard."""
    payload: bytes
    query: zenoh.Query

    def answer(self, message: Message) -> None:
        """Reply and close the query."""
        with self.query:
            self.query.reply(self.key, encode(message), encoding=ENCODING)

    def refuse(self, problem: str) -> None:
        """Reply with an error and close the query."""
        with self.query:
            self.query.reply_err(problem.encode(), encoding="text/plain")


@dataclass(frozen=True)
class Token:
    """A liveliness token appeared or disappeared."""

    key: str
    alive: bool


@dataclass(frozen=True)
class Link:
    """This process's link to the router came up or was lost.

    Zenoh reports all tokens as gone just *before* it reports its own link as lost.
    """

    up: bool


Event: TypeAlias = Received | Asked | Token | Link
Events: TypeAlias = Inbox[Event]


class Publisher:
    """Publishes messages on one key; `declare` it in a session before the first `put`.

    One that `may_wait` blocks on a slow link, as large messages must; others drop the message.
    """

    def __init__(self, session: zenoh.Session | None, key: str, *, may_wait: bool = False) -> None:
        self._key, self._may_wait = key, may_wait
        if session is not None:
            self.declare(session)

    def declare(self, session: zenoh.Session) -> None:
        wait, drop = zenoh.CongestionControl.BLOCK, zenoh.CongestionControl.DROP
        self._publisher = session.declare_publisher(
            self._key,
            encoding=ENCODING,
            congestion_control=wait if self._may_wait else drop,
            priority=zenoh.Priority.DATA_HIGH,
            express=True,
        )

    def put(self, message: Message) -> None:
        self._publisher.put(encode(message))


def directly(
    callback: Callable[[T], object], drop: Callable[[], object] | None = None
) -> "handlers.Callback[T]":
    """Return a handler that calls on the thread that reads the link, not on one of its own."""
    return handlers.Callback(callback, drop, indirect=False)


def subscribe(
    session: zenoh.Session,
    key: str,
    message: Any,
    inbox: Inbox[Any],
    kind: str,
    *,
    own: bool = True,
) -> zenoh.Subscriber[None]:
    """Put what is published on `key` into the inbox, as states of one kind.

    `message` is a class or a union; a payload beyond its limit is refused before it is copied.
    """
    most = max_bytes(message)

    def on_sample(sample: zenoh.Sample) -> None:
        if len(sample.payload) > most:
            inbox.count_refused(kind)
            return
        key, payload = str(sample.key_expr), sample.payload.to_bytes()
        inbox.put_newest(kind, Received(key, payload, time.monotonic_ns(), kind))

    origin = zenoh.Locality.ANY if own else zenoh.Locality.REMOTE
    return session.declare_subscriber(key, directly(on_sample), allowed_origin=origin)


class Unread:
    """The newest `count` messages on a key, which wake no thread; they are read when the loop asks.

    The inbox counts messages that are too large as of this kind.
    """

    def __init__(self, key: str, message: Any, inbox: Inbox[Any], kind: str, count: int) -> None:
        self._key, self._inbox, self._kind, self._count = key, inbox, kind, count
        self._max_bytes = max_bytes(message)
        self._subscriber: zenoh.Subscriber[handlers.Handler[zenoh.Sample]] | None = None

    def declare(self, session: zenoh.Session) -> None:
        self._subscriber = session.declare_subscriber(self._key, handlers.RingChannel(self._count))

    def drain(self) -> Iterator[bytes]:
        """Yield the payloads received since the last call, oldest first."""
        while self._subscriber and (sample := self._subscriber.try_recv()) is not None:
            if len(sample.payload) > self._max_bytes:
                self._inbox.count_refused(self._kind)
            else:
                yield sample.payload.to_bytes()


def serve(
    session: zenoh.Session, key: str, inbox: Inbox[Any], limit_bytes: int = SMALL_BYTES
) -> None:
    """Put queries on `key` into the inbox; refuse them at once if too large or while it is full.

    The queryable is not declared complete: of several complete ones a router queries only one,
    which may have a stale session.
    """

    def on_query(query: zenoh.Query) -> None:
        given = query.payload
        if given is not None and len(given) > limit_bytes:
            inbox.count_refused("query")
            Asked(key, b"", query).refuse("too large")
            return
        asked = Asked(key, given.to_bytes() if given is not None else b"", query)
        if not inbox.put(asked):
            asked.refuse("too busy; ask again")

    session.declare_queryable(key, directly(on_query))


def watch(session: zenoh.Session, key: str, inbox: Inbox[Any]) -> None:
    """Put changes of liveliness tokens on `key` into the inbox, existing tokens first.

    They have room of their own: a change that is lost while queries flood is never repeated.
    """
    inbox.keep("token", KEPT_TOKENS)

    def on_token(sample: zenoh.Sample) -> None:
        token = Token(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)
        inbox.put_newest("token", token)

    session.liveliness().declare_subscriber(key, directly(on_token), history=True)


def watch_link(session: zenoh.Session, inbox: Inbox[Any]) -> None:
    """Put changes of this session's link into the inbox, its present state first."""

    def on_transport(event: zenoh.TransportEvent) -> None:
        inbox.put_own(Link(event.kind == zenoh.SampleKind.PUT))

    session.info.declare_transport_events_listener(directly(on_transport), history=True)


def is_alive(session: zenoh.Session, key: str, timeout_s: float) -> bool:
    return bool(alive(session, key, timeout_s))


def alive(session: zenoh.Session, key: str, timeout_s: float) -> list[str]:
    """Return the sorted keys of the liveliness tokens that match `key`."""
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
    """Query `key` and return the first answer.

    Raises:
        RefusedError: only error replies of other processes came within `timeout_s`.
        UnreachableError: no reply of another process came.
        MalformedMessageError: the answer cannot be decoded as `answer`.
    """
    payload = encode(message) if message is not None else None
    error: type[UnreachableError] = UnreachableError
    problem = f"no process answers on {key!r}"
    for reply in session.get(key, payload=payload, consolidation=AS_THEY_COME, timeout=timeout_s):
        if reply.ok is not None:
            return decode(reply.ok.payload.to_bytes(), answer)
        if refusal := _refusal(reply):
            error, problem = RefusedError, f"no answer on {key!r}: {refusal}"
    raise error(peer=key, problem=problem, waited_s=timeout_s)


def ask_later(
    session: zenoh.Session,
    selector: str,
    on_answer: Callable[[Received], object],
    on_failure: Callable[[str], object],
    *,
    timeout_s: float,
    message: Message | None = None,
) -> None:
    """Query without blocking; one of the two callbacks runs on a Zenoh thread.

    `on_answer` takes the first answer, `on_failure` the last error; empty: the query timed out.
    """
    answered, refused = False, ""

    def on_reply(reply: zenoh.Reply) -> None:
        nonlocal answered, refused
        refused = _refusal(reply) or refused
        if reply.ok is not None and not answered:
            answered = True
            on_answer(Received(str(reply.ok.key_expr), reply.ok.payload.to_bytes()))

    session.get(
        selector,
        directly(on_reply, lambda: None if answered else on_failure(refused)),
        payload=encode(message) if message is not None else None,
        consolidation=AS_THEY_COME,
        timeout=timeout_s,
    )


def _refusal(reply: zenoh.Reply) -> str:
    """Return the text of an error reply of another process; empty: it is not one."""
    text = "" if reply.err is None else reply.err.payload.to_bytes().decode(errors="replace")
    return "" if text == _TIMED_OUT else text
