"""Malformed messages, and well-formed messages with impossible content."""

import math
from collections.abc import Mapping

import msgpack
import msgspec
import numpy as np

from protocol import keys
from protocol.arrays import ArrayBlob
from protocol.codec import decode, encode
from protocol.steps import LaserReading, OdometryReading

_DEEP = 5000
_HUGE_BIN = b"\xc6\xff\xff\xff\xff"
"""MessagePack: announces four gigabytes that do not follow."""
_FUTURE_NS = 3_600_000_000_000

Sent = tuple[str, bytes]
"""Key and payload."""

PUBLISHED = (
    keys.ODOMETRY_READING, keys.LASER_READING, keys.SCAN, keys.ODOMETRY, keys.BELIEF, keys.POSE,
    keys.CHECKPOINT, keys.BRIDGE_HEALTH, keys.worker_health("worker-0"),
    keys.worker_report("worker-0"), keys.worker_report("unknown"),
)  # fmt: skip
ASKED = (
    keys.POSE, keys.HYPOTHESES, keys.EVENTS, keys.STATUS, keys.MAP,
    f"{keys.SCAN_HISTORY}?first=x", keys.scan_history(-5, 2**70), keys.SET_POSE, keys.RELOCALIZE,
    keys.worker_order("worker-0"), keys.worker_state("worker-0"),
)  # fmt: skip


def malformed(rng: np.random.Generator, seen: Mapping[str, bytes]) -> list[Sent]:
    """Return malformed messages for each key that is published or queried.

    Args:
        rng: chooses the defects.
        seen: valid messages by key, which are modified.
    """
    sent = []
    for key in (*PUBLISHED, *ASKED):
        good = seen.get(key, msgpack.packb({"schema": "scan/1", "sender": "x", "step": 1}))
        sent += [(key, payload) for payload in _spoiled(rng, good)]
    return sent


def _spoiled(rng: np.random.Generator, good: bytes) -> list[bytes]:
    message = msgpack.unpackb(good)
    name = str(message.get("schema", "scan/1"))
    names = [field for field in message if field != "schema"]
    victim = names[int(rng.integers(len(names)))]
    return [
        b"",
        rng.bytes(200),
        good[: int(rng.integers(1, len(good)))],
        _HUGE_BIN,
        b"\x91" * _DEEP + b"\xc0",
        msgpack.packb([1, 2, 3]),
        msgpack.packb({**message, "schema": name.split("/", maxsplit=1)[0] + "/999"}),
        msgpack.packb({**message, victim: {"not": ["what", "it", "should", "be"]}}),
        msgpack.packb({field: value for field, value in message.items() if field != "sender"}),
    ]


def wrong_readings(seen: Mapping[str, bytes]) -> list[Sent]:
    """Return impossible readings: not finite, absurd, from the future, out of order.

    Args:
        seen: the newest valid messages by key; if one is missing the result is empty.
    """
    if not {keys.LASER_READING, keys.ODOMETRY_READING, keys.SCAN} <= set(seen):
        return []
    laser = decode(seen[keys.LASER_READING], LaserReading)
    odometry = decode(seen[keys.ODOMETRY_READING], OdometryReading)
    beams = len(laser.ranges.array())
    ranges = [
        np.full(beams, math.nan), np.full(beams, -1.0), np.full(beams, math.inf),
        np.zeros(beams), np.empty(0), np.full(1_000_000, 3.0),
    ]  # fmt: skip
    lasers = [
        msgspec.structs.replace(laser, ranges=ArrayBlob.of(values, "float32")) for values in ranges
    ]
    lasers += [
        msgspec.structs.replace(laser, stamp_ns=laser.stamp_ns + _FUTURE_NS),
        msgspec.structs.replace(laser, stamp_ns=laser.stamp_ns - _FUTURE_NS),
        msgspec.structs.replace(laser, angle_step_rad=math.nan),
        msgspec.structs.replace(laser, range_max_m=-1.0),
        msgspec.structs.replace(laser, robot_from_laser=(1e300, 0.0, 0.0)),
    ]
    _, y, heading = odometry.odom_from_robot
    poses = [(math.nan, y, heading), (math.inf, y, heading), (1e300, y, heading)]
    odometries = [msgspec.structs.replace(odometry, odom_from_robot=pose) for pose in poses]
    odometries += [
        msgspec.structs.replace(odometry, stamp_ns=odometry.stamp_ns + _FUTURE_NS),
        msgspec.structs.replace(odometry, stamp_ns=odometry.stamp_ns - _FUTURE_NS),
    ]
    return [
        *((keys.LASER_READING, encode(message)) for message in lasers),
        *((keys.ODOMETRY_READING, encode(message)) for message in odometries),
        (keys.SCAN, seen[keys.SCAN]),  # the last step again
    ]
