"""Key expressions, relative to the robot's namespace; each key has one writer.

The session puts Zenoh's `namespace`, the robot's name, in front of every key. So robots behind
one router never share a key.
"""

import re

from clustermcl.protocol.errors import MalformedMessageError

LONGEST_NAME = 64
ROOM_FOR_NUMBER = 8
"""Characters left for the suffix of child processes, which are called NAME-0, NAME-1 and so on."""

NAME_PATTERN = r"\A[A-Za-z0-9_]+(-[A-Za-z0-9_]+)*\Z"
"""No wildcard or slash of Zenoh, and no dot: a certificate is called ROLE.ROBOT."""

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
CHANGES = "changes"

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

ALL_REPORTS = "worker/*/report"
ALL_WORKERS_ALIVE = "worker/*/alive"
ALL_WORKERS_HEALTH = "worker/*/health"


def scan_history(first: int, last: int | None) -> str:
    """Return the selector of the steps `first` to `last`, inclusive; None: to the newest."""
    end = f";last={last}" if last is not None else ""
    return f"{SCAN_HISTORY}?first={first}{end}"


worker_alive = "worker/{}/alive".format
worker_report = "worker/{}/report".format
worker_health = "worker/{}/health".format
worker_order = "worker/{}/order".format
"""Key of queries that carry a work order."""
worker_state = "worker/{}/state".format
"""Key of queries for a worker's jobs, and of a `TakeOver`."""
worker_advice = "worker/{}/advice".format
"""Key of queries that carry an `AdviceQuestion`."""


def worker_name(key: str) -> str:
    """Return the name of the worker that a key belongs to; or raise a `MalformedMessageError`."""
    match key.split("/"):
        case ["worker", name, _] if is_name(name):
            return name
        case ["worker", name, _]:
            problem = f"{name!r}: not {name_rule()}"
            raise MalformedMessageError(expected="worker name", problem=problem)
    raise MalformedMessageError(expected="worker's key", problem=key)


def is_name(text: str, longest: int = LONGEST_NAME) -> bool:
    """Return whether a text is a valid name of a robot or a process."""
    return len(text) <= longest and re.search(NAME_PATTERN, text) is not None


def name_rule(longest: int = LONGEST_NAME) -> str:
    return f"letters, digits, _ and single - between them, at most {longest}"
