"""Limits for the size of messages; a larger one is refused before it is copied or decoded."""

from collections.abc import Mapping
from functools import cache, lru_cache
from types import MappingProxyType
from typing import Any, get_args

from protocol import keys
from protocol.answers import (
    Belief,
    Configure,
    Drive,
    Hypotheses,
    Kidnap,
    Relocalize,
    SetPose,
    Status,
    Update,
)
from protocol.errors import MalformedMessageError
from protocol.job_events import JobEvents
from protocol.keys import WorkerKey, WorkerTopic
from protocol.sizes import LARGEST_BYTES, LIST_BYTES, SCAN_BYTES, SMALL_BYTES
from protocol.steps import LaserReading, MapMessage, MapReading, OdometryReading, Scan, ScanHistory
from protocol.work import Checkpoint, Report, SearchReport, TrackReport, WorkerState, WorkOrder

_BYTES: Mapping[Any, int] = MappingProxyType(
    dict.fromkeys((LaserReading, Scan), SCAN_BYTES)
    | dict.fromkeys((Belief, Hypotheses, JobEvents, Status), LIST_BYTES)
    | dict.fromkeys((MapMessage, MapReading, ScanHistory, TrackReport, SearchReport), LARGEST_BYTES)
    | dict.fromkeys((WorkOrder, WorkerState, Checkpoint), LARGEST_BYTES)
)


@cache
def max_bytes(expected: Any) -> int:
    """Size limit of a message class, or of a union of them [bytes]."""
    return max(_BYTES.get(kind, SMALL_BYTES) for kind in get_args(expected) or (expected,))


_ON_KEY: Mapping[str, Any] = MappingProxyType(
    {
        keys.ODOMETRY_READING: OdometryReading,
        keys.LASER_READING: LaserReading,
        keys.MAP_READING: MapReading,
        keys.SCAN: Scan,
        keys.ODOMETRY: OdometryReading,
        keys.BELIEF: Belief,
        keys.EVENTS: JobEvents,
        keys.CHECKPOINT: Checkpoint,
        keys.SET_POSE: SetPose,
        keys.RELOCALIZE: Relocalize,
        keys.KIDNAP: Kidnap,
        keys.UPDATE: Update,
        keys.CONFIGURE: Configure,
        keys.DRIVE: Drive,
        WorkerTopic.ORDER: WorkOrder,
        WorkerTopic.REPORT: Report,
    }
)
"""Messages published or queried on each key; payloads on other keys are small or empty."""


@lru_cache(maxsize=1024)
def max_bytes_on(key: str) -> int:
    """Size limit of a message on a key, or of the payload of a query there [bytes]."""
    try:
        parsed = keys.parsed(key)
    except MalformedMessageError:
        return SMALL_BYTES  # the key of an extension
    return max_bytes(_ON_KEY.get(parsed.topic if isinstance(parsed, WorkerKey) else parsed))
