"""The conventions of rmw_zenoh: keys, liveliness tokens and attachments.

A key is `<domain>/<full name>/<type>/<hash of the type>`. Each node, publisher, subscriber, client
and service has a liveliness token that describes it; the tokens are ROS's graph. Each message has
an attachment of 33 bytes: a sequence number, a time, and the id of its sender.
"""

import struct
from dataclasses import dataclass
from enum import StrEnum

import xxhash

GRAPH = "@ros2_lv"
HUMBLE_HASH = "TypeHashNotSupported"
"""Stands for every type hash in ROS 2 Humble."""

_ATTACHMENT = struct.Struct("<qqB16s")
_ID_BYTES = 16
_NODE_CHUNKS, _ENDPOINT_CHUNKS = 9, 13
_HASH_CHUNK = 11


class EndpointKind(StrEnum):
    """Kinds of endpoints, with rmw_zenoh's abbreviations."""

    PUBLISHER = "MP"
    SUBSCRIBER = "MS"
    SERVICE = "SS"
    CLIENT = "SC"


@dataclass(frozen=True)
class Qos:
    """Quality of service of a topic.

    Messages of a `best_effort` topic may be lost. Late subscribers of a `latched` one get the last
    `depth` messages (`transient local`).
    """

    depth: int = 10
    best_effort: bool = False
    latched: bool = False

    def __str__(self) -> str:
        """Return the form in tokens, which omit ROS's defaults."""
        reliability = "2" if self.best_effort else ""
        durability = "1" if self.latched else ""
        return f"{reliability}:{durability}:,{self.depth}:,:,:,,"


@dataclass(frozen=True)
class NodeName:
    """The full name of a node, such as ``amcl`` in ``/robot1``; an empty namespace is the root."""

    domain_id: int
    namespace: str
    name: str

    def topic(self, name: str) -> str:
        """Return a topic's or service's full name; ``/absolute`` and ``~/private`` follow ROS."""
        if name.startswith("/"):
            return name
        if name.startswith("~/"):
            name = f"{self.name}/{name[2:]}"
        return f"{self.namespace}/{name}"

    def token(self, session_id: str) -> str:
        """Return the node's token; the node is number 0, the only one of its session."""
        return f"{GRAPH}/{self.domain_id}/{session_id}/0/0/NN/{self._owner()}"

    def endpoint_token(
        self,
        session_id: str,
        number: int,
        kind: EndpointKind,
        topic: str,
        ros_type: str,
        type_hash: str,
        qos: Qos,
    ) -> str:
        """Return the token of one of the node's endpoints; numbers above 0, each used once."""
        start = f"{GRAPH}/{self.domain_id}/{session_id}/0/{number}/{kind}"
        about = f"{_chunk(topic)}/{_dds_type(ros_type)}/{type_hash}"
        return f"{start}/{self._owner()}/{about}/{qos}"

    def _owner(self) -> str:
        return f"%/{_chunk(self.namespace)}/{self.name}"  # the enclave is always the root


def _dds_type(ros_type: str) -> str:
    """Return the form in keys, `std_msgs::msg::dds_::String_`, of `std_msgs/msg/String`."""
    package, kind, name = ros_type.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def data_key(domain_id: int, topic: str, ros_type: str, type_hash: str) -> str:
    """Return the key of a topic's messages, or of a service's calls, by its full name.

    The hash ``*`` receives from any release of ROS.
    """
    return f"{domain_id}/{topic.strip('/')}/{_dds_type(ros_type)}/{type_hash}"


def hash_in_token(token: str) -> str | None:
    """Return the type's hash in an endpoint's token; None for another kind of token.

    Newer releases append more parts to the common thirteen.
    """
    chunks = token.split("/")
    if chunks[0] != GRAPH or len(chunks) < _ENDPOINT_CHUNKS:
        return None
    return chunks[_HASH_CHUNK]


def node_in_token(token: str) -> str | None:
    """Return the full name in a node's token; None for another kind of token."""
    chunks = token.split("/")
    if chunks[0] != GRAPH or len(chunks) != _NODE_CHUNKS or chunks[5] != "NN":
        return None
    namespace = chunks[7].replace("%", "/").rstrip("/")
    return f"{namespace}/{chunks[8]}"


def endpoint_id(token: str) -> bytes:
    """Return the 16-byte id of an endpoint in attachments: XXH3-128 of its token."""
    return xxhash.xxh3_128_digest(token.encode())[::-1]  # little-endian


def attachment(sequence: int, time_ns: int, endpoint: bytes) -> bytes:
    """Return the attachment of a message; ROS drops messages without one.

    A sender counts its messages from 1. The time is the wall clock, also under simulated time.
    """
    return _ATTACHMENT.pack(sequence, time_ns, _ID_BYTES, endpoint)


def parsed_attachment(data: bytes) -> tuple[int, int, bytes]:
    """Return an attachment's sequence number, time [ns] and sender's id.

    Raises:
        ValueError: `data` is not the attachment of a ROS message.
    """
    if len(data) != _ATTACHMENT.size:
        raise ValueError(f"an attachment of {len(data)} bytes, not {_ATTACHMENT.size}")
    sequence, time_ns, id_bytes, endpoint = _ATTACHMENT.unpack(data)
    if id_bytes != _ID_BYTES:
        raise ValueError(f"an attachment with an id of {id_bytes} bytes, not {_ID_BYTES}")
    return sequence, time_ns, endpoint


def _chunk(name: str) -> str:
    """Encode a name with slashes as one part of a key; the root is ``%``."""
    return name.replace("/", "%") or "%"
