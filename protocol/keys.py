"""Key expressions, relative to the robot's namespace: one writer for each key.

Zenoh's `namespace` (the robot's name) is put before every key by the session, so keys of
several robots behind one router never meet.
"""

from protocol.errors import MalformedMessageError
from protocol.names import is_name, name_rule

ODOMETRY_READING = "readings/odometry"
LASER_READING = "readings/laser"

SCAN = "scan"
ODOMETRY = "odometry"
SCAN_HISTORY = "scans"
MAP = "map"
TRUTH = "truth"
BRIDGE_ALIVE = "bridge/alive"
BRIDGE_HEALTH = "bridge/health"
KIDNAP = "simulator/kidnap"

BELIEF = "belief"
POSE = "pose"
HYPOTHESES = "hypotheses"
STATUS = "status"
SET_POSE = "command/set_pose"
RELOCALIZE = "command/relocalize"
COORDINATOR_ALIVE = "coordinator/alive"
CHECKPOINT = "checkpoint"

ALL_REPORTS = "worker/*/report"
ALL_WORKERS_ALIVE = "worker/*/alive"
ALL_WORKERS_HEALTH = "worker/*/health"


def scan_history(first: int, last: int | None) -> str:
    """Selector of the steps `first` to `last`, both included; None: to the newest."""
    end = f";last={last}" if last is not None else ""
    return f"{SCAN_HISTORY}?first={first}{end}"


def worker_alive(name: str) -> str:
    """Liveliness token of a worker."""
    return f"worker/{name}/alive"


def worker_order(name: str) -> str:
    """Where a worker takes its work orders."""
    return f"worker/{name}/order"


def worker_state(name: str) -> str:
    """Where a worker says what it does."""
    return f"worker/{name}/state"


def worker_report(name: str) -> str:
    """Where a worker publishes what its jobs made of a step."""
    return f"worker/{name}/report"


def worker_health(name: str) -> str:
    """Where a worker says how it is."""
    return f"worker/{name}/health"


def worker_name(key: str) -> str:
    """The worker's name in one of its keys.

    Raises:
        ValueError: the key is no worker's.
        MalformedMessageError: no worker may be called so.
    """
    parts = key.split("/")
    if len(parts) != 3 or parts[0] != "worker":  # worker/{name}/{what}
        raise ValueError(f"not a worker's key: {key!r}")
    if not is_name(parts[1]):
        raise MalformedMessageError(
            expected="worker name", problem=f"{parts[1]!r}: not {name_rule()}"
        )
    return parts[1]
