"""Messages and queries of an intruder that no process of ours sends."""

import math
from collections.abc import Iterator
from contextlib import suppress

import msgpack
import msgspec
import numpy as np
import zenoh

from clustermcl.protocol import keys
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.message import Message
from clustermcl.protocol.steps import LaserReading, OdometryReading, Scan
from tests.unit.coordinator.reports import cloud_at, tracked

WORKER = "worker-0"
NO_NAME = "a worker\n"
ANOTHER_MAP = "of another map"
ORIGIN = (0.0, 0.0, 0.0)
NAN = math.nan

PUBLISHED = (
    keys.SCAN, keys.ODOMETRY, keys.BELIEF, keys.POSE, keys.CHECKPOINT, keys.TRUTH,
    keys.BRIDGE_HEALTH, keys.ODOMETRY_READING, keys.LASER_READING, keys.MAP_READING,
    keys.worker_report(WORKER), keys.worker_health(WORKER),
)  # fmt: skip
SERVED = (
    keys.MAP, keys.SCAN_HISTORY, keys.POSE, keys.HYPOTHESES, keys.STATUS, keys.SET_POSE,
    keys.RELOCALIZE, keys.UPDATE, keys.KIDNAP, keys.worker_order(WORKER), keys.worker_state(WORKER),
    keys.ADVICE, keys.worker_advice(WORKER),
)  # fmt: skip

NO_MESSAGES = {
    "nothing": b"",
    "text": b"hello",
    "noise": bytes(range(256)),
    "a number": msgpack.packb(7),
    "another message": msgpack.packb({"schema": "gossip/1", "sender": "x"}),
    "a later version": msgpack.packb({"schema": "scan/9", "sender": "x"}),
    "no fields": msgpack.packb({"schema": "scan/1", "sender": "x"}),
    "deep": b"\x91" * 60_000,
    "announced": b"\xdd\xff\xff\xff\xff",
    "many": b"\xdc\x4e\x20" + b"\x90" * 20_000,
    "a megabyte": bytes(1_000_000),
    "control characters": msgpack.packb({"schema": "\x1b[2J\n\n", "sender": "\0"}),
}


HOUR_NS = 3600 * 10**9


def no_messages() -> Iterator[tuple[str, bytes]]:
    """Yield everything of `NO_MESSAGES` for each key that is published or queried."""
    for key in (*PUBLISHED, *SERVED):
        for data in NO_MESSAGES.values():
            if data or key != keys.RELOCALIZE:  # whose query needs none
                yield key, data


def bad_readings(laser: LaserReading, odometry: OdometryReading) -> Iterator[tuple[str, bytes]]:
    """Yield impossible readings, each with one wrong number of these: key and bytes."""

    def ranges(values: list[float]) -> ArrayBlob:
        return ArrayBlob.of(np.array(values), "float32")

    x, y, heading = odometry.odom_from_robot
    for change in (
        {"ranges": ranges([NAN] * 3)}, {"ranges": ranges([0.0, -1.0, math.inf])},
        {"ranges": ranges([])}, {"ranges": ranges([1.0] * 30_000)},
        {"ranges": ArrayBlob(dtype="float32", shape=(3,), data=b"12")},
        {"ranges": ArrayBlob(dtype="int8", shape=(2**40, 2**40), data=b"")},
        {"angle_step_rad": 5.0}, {"angle_min_rad": NAN}, {"range_max_m": -1.0},
        {"robot_from_laser": (1e300, 0.0, 0.0)}, {"stamp_ns": 2**63 - 1},
        {"stamp_ns": laser.stamp_ns + HOUR_NS}, {"stamp_ns": laser.stamp_ns - HOUR_NS},
        {"odom_from_robot": (100.0 + x, y, heading)}, {"odom_from_robot": (NAN, 0.0, 0.0)},
    ):  # fmt: skip
        yield keys.LASER_READING, encode(msgspec.structs.replace(laser, **change))
    for pose in ((x + 100.0, y, heading), (math.inf, 0.0, 0.0), (0.0, 1e9, 0.0)):
        changed = msgspec.structs.replace(odometry, odom_from_robot=pose)
        yield keys.ODOMETRY_READING, encode(changed)


class ForeignSender:
    def __init__(self, session: zenoh.Session) -> None:
        self.session = session
        self.scans: dict[int, Scan] = {}
        """The bridge's, by step."""
        session.declare_subscriber(keys.SCAN, self._on_scan)

    def _on_scan(self, sample: zenoh.Sample) -> None:
        with suppress(MalformedMessageError):
            scan = decode(sample.payload.to_bytes(), Scan)
            if scan.map_digest != ANOTHER_MAP:
                self.scans.setdefault(scan.step, scan)

    def speak(self) -> None:
        """Publish no messages, and scans and reports that come at the wrong time or are wrong."""
        with self.session.liveliness().declare_token(keys.worker_alive(NO_NAME)):
            pass
        for key, data in no_messages():
            if key in PUBLISHED:
                self._put(key, data)
        *_, scan = self.scans.values()
        report, old = keys.worker_report(WORKER), tracked("c0", scan.step, 1e9, ORIGIN, epoch=0)
        no_weight = ArrayBlob.of(np.full(2, -math.inf), "float64")
        weightless = msgspec.structs.replace(cloud_at(ORIGIN, scan.step), log_weights=no_weight)
        wrong: list[tuple[str, Message]] = [
            (keys.SCAN, msgspec.structs.replace(scan, map_digest=ANOTHER_MAP, step=scan.step + 1)),
            (keys.SCAN, msgspec.structs.replace(scan, angle_step_rad=NAN)),
            *((keys.SCAN, again) for again in reversed([*self.scans.values()][-4:])),
            (keys.worker_report(NO_NAME), old),
            (report, old),
            (report, msgspec.structs.replace(old, snapshot=weightless)),
        ]
        for key, message in wrong:
            self._put(key, encode(message))

    def ask(self) -> None:
        for key, data in no_messages():
            if key in SERVED:
                self._get(key, data)
        for selector in ("scans?first=x", f"scans?first={'9' * 5000}", "scans?last=-1;first=-7"):
            self._get(selector, b"")

    def shout(self) -> None:
        """A hundred megabytes on keys of all workers and the coordinator."""
        for key in (keys.SCAN, keys.worker_report(WORKER)):
            self._put(key, bytes(100_000_000))
            self._put(key, bytes(33_000_000))

    def _put(self, key: str, data: bytes) -> None:
        self.session.put(key, data, congestion_control=zenoh.CongestionControl.BLOCK)

    def _get(self, selector: str, data: bytes) -> None:
        self.session.get(selector, lambda _reply: None, payload=data, timeout=0.5)
