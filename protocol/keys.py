"""Key expressions, relative to the robot's namespace; each key has one writer.

The session puts Zenoh's `namespace`, the robot's name, in front of every key. So robots behind
one router never share a key.
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

from protocol.errors import MalformedMessageError
from protocol.names import is_name, name_rule

ODOMETRY_READING = "readings/odometry"
LASER_READING = "readings/laser"
MAP_READING = "readings/map"
OBSERVATION_READING = "readings/observation"

SCAN = "scan"
ODOMETRY = "odometry"
SCAN_HISTORY = "scans"
MAP = "map"
TRUTH = "truth"
BRIDGE_ALIVE = "bridge/alive"
BRIDGE_HEALTH = "bridge/health"
KIDNAP = "simulator/kidnap"
UPDATE = "command/update"
CONFIGURE = "command/configure"
DRIVE = "simulator/drive"

BELIEF = "belief"
POSE = "pose"
HYPOTHESES = "hypotheses"
EVENTS = "events"
STATUS = "status"
ADVICE = "advice"
SET_POSE = "command/set_pose"
RELOCALIZE = "command/relocalize"
COORDINATOR_ALIVE = "coordinator/alive"
CHECKPOINT = "checkpoint"

_CONSTANT = frozenset((
    ODOMETRY_READING, LASER_READING, MAP_READING, OBSERVATION_READING, SCAN, ODOMETRY,
    SCAN_HISTORY, MAP, TRUTH,
    BRIDGE_ALIVE, BRIDGE_HEALTH, KIDNAP, DRIVE, UPDATE, CONFIGURE, BELIEF, POSE, HYPOTHESES,
    EVENTS, STATUS, ADVICE, SET_POSE, RELOCALIZE, COORDINATOR_ALIVE, CHECKPOINT,
))  # fmt: skip

ALL_REPORTS = "worker/*/report"
ALL_WORKERS_ALIVE = "worker/*/alive"
ALL_WORKERS_HEALTH = "worker/*/health"


def scan_history(first: int, last: int | None) -> str:
    """Return the selector of the steps `first` to `last`, inclusive; None: to the newest."""
    end = f";last={last}" if last is not None else ""
    return f"{SCAN_HISTORY}?first={first}{end}"


def worker_alive(name: str) -> str:
    return f"worker/{name}/{WorkerTopic.ALIVE}"


def worker_order(name: str) -> str:
    """Return the key of queries that carry a work order."""
    return f"worker/{name}/{WorkerTopic.ORDER}"


def worker_state(name: str) -> str:
    """Return the key of queries for a worker's jobs, and of a `TakeOver`."""
    return f"worker/{name}/{WorkerTopic.STATE}"


def worker_advice(name: str) -> str:
    """Return the key of queries that carry an `AdviceQuestion`."""
    return f"worker/{name}/{WorkerTopic.ADVICE}"


def worker_report(name: str) -> str:
    return f"worker/{name}/{WorkerTopic.REPORT}"


def worker_health(name: str) -> str:
    return f"worker/{name}/{WorkerTopic.HEALTH}"


# --- keys as they arrive ------------------------------------------------------------------------


class WorkerTopic(StrEnum):
    """The last part of a worker's key, ``worker/{name}/{topic}``."""

    ALIVE = "alive"
    ORDER = "order"
    STATE = "state"
    ADVICE = "advice"
    REPORT = "report"
    HEALTH = "health"


@dataclass(frozen=True)
class WorkerKey:
    """A worker's name and the topic, parsed from a key."""

    worker: str
    topic: WorkerTopic


@lru_cache(maxsize=1024)
def parsed(key: str) -> str | WorkerKey:
    """Parse a key: return a constant of this module, or a `WorkerKey`.

    Raises:
        MalformedMessageError: the protocol has no such key, or the worker's name is invalid.
    """
    if key in _CONSTANT:
        return key
    match key.split("/"):
        case ["worker", name, topic] if topic in set(WorkerTopic):
            if not is_name(name):
                problem = f"{name!r}: not {name_rule()}"
                raise MalformedMessageError(expected="worker name", problem=problem)
            return WorkerKey(name, WorkerTopic(topic))
    raise MalformedMessageError(expected="key", problem=key)


def worker_name(key: str) -> str:
    """Return the name of the worker that a key belongs to.

    Raises:
        MalformedMessageError: the key is not a worker's.
    """
    match parsed(key):
        case WorkerKey(worker=name):
            return name
    raise MalformedMessageError(expected="worker's key", problem=key)
