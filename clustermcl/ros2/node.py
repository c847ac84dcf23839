"""A ROS 2 node on a Zenoh session: publishers, subscriptions, services, tokens, and its log."""

import itertools
import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import zenoh
from zenoh import ext

from clustermcl.link.inbox import Inbox
from clustermcl.link.wire import directly
from clustermcl.ros2 import wire
from clustermcl.ros2.message_types import LOG, encode, new, type_hash
from clustermcl.ros2.messages_out import header
from clustermcl.ros2.topics import Topic

MAX_MESSAGE_BYTES = 64 * 1024 * 1024
_HEARTBEAT_S = 0.5
_LEVELS = (10, 20, 30, 40, 50)
"""Of a log; the same numbers in ROS and Python."""


@dataclass(frozen=True)
class FromRos:
    """A message of a topic, still undecoded."""

    topic: Topic
    payload: bytes
    problem: str = ""
    """Why it is not a ROS message; empty: it seems to be one."""


@dataclass(frozen=True)
class Called:
    """A call of a service that waits for its response."""

    service: str
    payload: bytes
    query: zenoh.Query
    problem: str = ""

    def respond(self, response: bytes) -> None:
        """Send the response; ROS has no error replies, so a refusal is a response too."""
        with self.query:
            sequence, _, caller = wire.parsed_attachment(_attached(self.query))
            self.query.reply(
                self.query.key_expr,
                response,
                attachment=wire.attachment(sequence, time.time_ns(), caller),
            )

    def drop(self) -> None:
        """End it without a response; the caller keeps waiting."""
        with self.query:
            pass


class RosPublisher:
    """Publishes the messages of one topic; thread-safe."""

    def __init__(self, session: zenoh.Session, key: str, token: str, topic: Topic) -> None:
        self._type, self._id = topic.ros_type, wire.endpoint_id(token)
        self._sequence = itertools.count(1)
        self._one_at_a_time = threading.Lock()
        self._publisher: zenoh.Publisher | ext.AdvancedPublisher
        if topic.qos.latched:
            self._publisher = ext.declare_advanced_publisher(
                session,
                key,
                congestion_control=zenoh.CongestionControl.DROP,
                cache=ext.CacheConfig(max_samples=topic.qos.depth),
                publisher_detection=True,
                sample_miss_detection=ext.MissDetectionConfig(
                    heartbeat=None, sporadic_heartbeat=_HEARTBEAT_S
                ),
            )
        else:
            self._publisher = session.declare_publisher(
                key, congestion_control=zenoh.CongestionControl.DROP
            )

    def put(self, message: Any) -> None:
        """Publish a message, or its CDR bytes."""
        data = message if isinstance(message, bytes) else encode(message, self._type)
        with self._one_at_a_time:
            attached = wire.attachment(next(self._sequence), time.time_ns(), self._id)
            self._publisher.put(data, attachment=attached)


class RosNode:
    """A node in ROS's graph, until its session, which has no namespace, is closed."""

    def __init__(self, session: zenoh.Session, name: wire.NodeName, *, humble: bool) -> None:
        self._session, self._name, self._humble = session, name, humble
        self._id = str(session.info.zid())
        self._numbers = itertools.count(1)
        self._kept: list[Any] = []
        """Tokens and advanced subscribers, which end with their last reference."""
        self._announce(name.token(self._id))

    def publisher(self, topic: Topic) -> RosPublisher:
        key, token = self._endpoint(
            wire.EndpointKind.PUBLISHER, topic.name, topic.ros_type, topic.qos
        )
        publisher = RosPublisher(self._session, key, token, topic)
        self._announce(token)
        return publisher

    def subscribe(self, topic: Topic, inbox: Inbox[Any]) -> None:
        """Put the topic's messages into an inbox as `FromRos`; if it is full, drop the oldest.

        Messages of any release of ROS are received, but not those that this session publishes.
        """

        def on_sample(sample: zenoh.Sample) -> None:
            if len(sample.payload) > MAX_MESSAGE_BYTES:
                inbox.count_refused(topic.name)
                return
            problem = _attachment_problem(sample)
            inbox.put_newest(topic.name, FromRos(topic, sample.payload.to_bytes(), problem))

        kind = wire.EndpointKind.SUBSCRIBER
        _, token = self._endpoint(kind, topic.name, topic.ros_type, topic.qos)
        key = wire.data_key(self._name.domain_id, self._name.topic(topic.name), topic.ros_type, "*")
        if topic.qos.latched:
            self._kept.append(
                ext.declare_advanced_subscriber(
                    self._session,
                    key,
                    on_sample,
                    history=ext.HistoryConfig(
                        detect_late_publishers=True, max_samples=topic.qos.depth
                    ),
                    recovery=ext.RecoveryConfig(heartbeat=True, periodic_queries=None),
                    subscriber_detection=True,
                )
            )
        else:
            remote = zenoh.Locality.REMOTE
            self._session.declare_subscriber(key, directly(on_sample), allowed_origin=remote)
        self._announce(token)

    def serve(self, service: str, ros_type: str, inbox: Inbox[Any]) -> None:
        """Put the calls of a service into an inbox, as `Called`."""

        def on_query(query: zenoh.Query) -> None:
            payload = b""
            if query.payload is not None and len(query.payload) <= MAX_MESSAGE_BYTES:
                payload = query.payload.to_bytes()
            called = Called(service, payload, query, _attachment_problem(query))
            if not inbox.put(called):
                called.drop()

        # As in `rclpy`, parameter services have a longer queue.
        qos = wire.Qos(depth=1000) if ros_type.startswith("rcl_interfaces/") else wire.Qos()
        key, token = self._endpoint(wire.EndpointKind.SERVICE, service, ros_type, qos)
        self._session.declare_queryable(key, directly(on_query), complete=True)
        self._announce(token)

    def _endpoint(
        self, kind: wire.EndpointKind, topic: str, ros_type: str, qos: wire.Qos
    ) -> tuple[str, str]:
        name, hashed = self._name.topic(topic), type_hash(ros_type, humble=self._humble)
        number = next(self._numbers)
        token = self._name.endpoint_token(self._id, number, kind, name, ros_type, hashed, qos)
        return wire.data_key(self._name.domain_id, name, ros_type, hashed), token

    def _announce(self, token: str) -> None:
        self._kept.append(self._session.liveliness().declare_token(token))


def _attached(received: zenoh.Query | zenoh.Sample) -> bytes:
    return received.attachment.to_bytes() if received.attachment is not None else b""


def _attachment_problem(received: zenoh.Query | zenoh.Sample) -> str:
    """Return why something received is not of ROS; empty: it seems to be."""
    try:
        wire.parsed_attachment(_attached(received))
    except ValueError as error:
        return str(error)
    return ""


class _RosLog(logging.Handler):
    def __init__(self, publisher: RosPublisher, name: str) -> None:
        super().__init__(logging.INFO)
        self._publisher, self._name = publisher, name

    def emit(self, record: logging.LogRecord) -> None:
        message = new(
            LOG,
            stamp=header(int(record.created * 1e9), "").stamp,
            level=max(level for level in _LEVELS if level <= record.levelno),
            name=self._name,
            msg=record.getMessage(),
            file=record.pathname,
            function=record.funcName or "",
            line=record.lineno,
        )
        with suppress(zenoh.ZError):  # the session is being closed
            self._publisher.put(message)


@contextmanager
def log_to_ros(publisher: RosPublisher, node: str) -> Iterator[None]:
    """Publish the log on `/rosout` too, within the ``with`` block; `node`: its full name."""
    handler = _RosLog(publisher, node.strip("/").replace("/", "."))
    logging.getLogger().addHandler(handler)
    try:
        yield
    finally:
        logging.getLogger().removeHandler(handler)
