"""Zenoh's access control for the router, generated from one table of roles.

The router identifies a process by the common name of its certificate, ``ROLE`` or ``ROLE.ROBOT``.
Everything is denied unless a rule allows it. Zenoh checks the key of every message that enters or
leaves the router and drops denied ones without an error.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any

from clustermcl.protocol import keys
from clustermcl.protocol.errors import SettingsError
from clustermcl.protocol.keys import is_name, name_rule

ALL_ROBOTS = "*"
WORKER = "worker"
WORKER_PROCESSES = 32
"""Processes that one worker certificate covers: NAME-0 to NAME-31."""

_FLOWS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "publishes": (("put",), ("declare_subscriber",)),
    "reads": (("declare_subscriber",), ("put",)),
    "serves": (("declare_queryable", "reply"), ("query",)),
    "asks": (("query",), ("reply", "declare_queryable")),
    "announces": (("liveliness_token",), ()),
    "watches": (
        ("declare_liveliness_subscriber", "liveliness_query"),
        ("liveliness_token", "reply"),
    ),
}
"""Right: the message types it needs inbound (ingress) and outbound (egress) at the router."""


@dataclass(frozen=True)
class Rights:
    """Key expressions that one role may use, relative to a robot's name."""

    publishes: tuple[str, ...] = ()
    reads: tuple[str, ...] = ()
    serves: tuple[str, ...] = ()
    asks: tuple[str, ...] = ()
    announces: tuple[str, ...] = ()
    """Liveliness tokens it declares."""
    watches: tuple[str, ...] = ()
    """Liveliness tokens it subscribes to."""


def rights_of(role: str, *workers: str) -> Rights:
    """Return the rights of a role; of a worker for these processes (names or patterns), or all."""
    if role == WORKER:
        names = workers or ("*",)
        return Rights(
            publishes=(*map(keys.worker_report, names), *map(keys.worker_health, names)),
            reads=(keys.SCAN, keys.CHECKPOINT),
            serves=(
                *map(keys.worker_order, names),
                *map(keys.worker_state, names),
                *map(keys.worker_advice, names),
            ),
            asks=(keys.MAP, keys.SCAN_HISTORY),
            announces=tuple(map(keys.worker_alive, names)),
            watches=(keys.COORDINATOR_ALIVE,),
        )
    return _ROLES[role]


_VIEWER = Rights(
    reads=(keys.POSE, keys.BELIEF, keys.EVENTS, keys.TRUTH, keys.SCAN, keys.CHANGES),
    asks=(
        *(keys.POSE, keys.HYPOTHESES, keys.EVENTS, keys.STATUS, keys.ADVICE, keys.MAP),
        keys.CHANGES,
    ),
)

_READINGS = (keys.ODOMETRY_READING, keys.LASER_READING, keys.MAP_READING, keys.OBSERVATION_READING)

_ROLES = {
    "robot": Rights(
        publishes=_READINGS,
        reads=(keys.POSE, keys.EVENTS),
        serves=(keys.MAP_READING,),
        asks=(keys.POSE, keys.EVENTS),
    ),
    "bridge": Rights(
        publishes=(keys.SCAN, keys.ODOMETRY, keys.TRUTH, keys.BRIDGE_HEALTH, keys.CHANGES),
        reads=(*_READINGS, keys.BELIEF),
        serves=(
            *(keys.MAP, keys.SCAN_HISTORY, keys.KIDNAP, keys.UPDATE, keys.CONFIGURE),
            keys.CHANGES,
        ),
        asks=(keys.STATUS, keys.MAP_READING),
        announces=(keys.BRIDGE_ALIVE,),
        watches=(keys.BRIDGE_ALIVE, keys.COORDINATOR_ALIVE),
    ),
    "coordinator": Rights(
        publishes=(keys.BELIEF, keys.POSE, keys.EVENTS, keys.CHECKPOINT),
        reads=(
            *(keys.SCAN, keys.ODOMETRY, keys.ALL_REPORTS, keys.CHECKPOINT),
            *(keys.BRIDGE_HEALTH, keys.ALL_WORKERS_HEALTH),
        ),
        serves=(
            *(keys.POSE, keys.HYPOTHESES, keys.EVENTS, keys.STATUS, keys.ADVICE),
            *(keys.SET_POSE, keys.RELOCALIZE),
        ),
        asks=(
            *(keys.worker_order("*"), keys.worker_state("*"), keys.worker_advice("*")),
            *(keys.SCAN_HISTORY, keys.MAP),
            keys.STATUS,  # a standby serves metrics and probes from the active coordinator's status
        ),
        announces=(keys.COORDINATOR_ALIVE,),
        watches=(keys.ALL_WORKERS_ALIVE, keys.COORDINATOR_ALIVE),
    ),
    "ros2": Rights(
        publishes=_READINGS,
        reads=(keys.BELIEF, keys.ALL_REPORTS, keys.CHANGES),
        serves=(keys.MAP_READING,),
        asks=(
            *(keys.STATUS, keys.ADVICE, keys.SET_POSE, keys.RELOCALIZE),
            *(keys.UPDATE, keys.CONFIGURE, keys.CHANGES),
        ),
    ),
    "viewer": _VIEWER,
    "operator": Rights(
        reads=_VIEWER.reads,
        asks=(
            *(*_VIEWER.asks, keys.SET_POSE, keys.RELOCALIZE, keys.UPDATE, keys.CONFIGURE),
            keys.KIDNAP,
        ),
    ),
}

ROLES = (*_ROLES, WORKER)


def doubt_of_certificate(file: str, roles: Sequence[str], process: str, robot: str) -> str:
    """Return why a process with this certificate would not be heard; empty if it would be.

    Names other than ``ROLE`` and ``ROLE.ROBOT`` raise no doubt, because an access control of
    one's own may know them. The name of the process matters only for a worker.
    """
    from clustermcl.link.tls import common_name  # noqa: PLC0415 - only where there is TLS

    owner, _, of_robot = common_name(file).partition(".")
    role = WORKER if owner.startswith(f"{WORKER}-") else owner
    if role not in (*ROLES, "router"):
        return ""
    if role not in roles:
        return f"its role is {role}, and this needs {' or '.join(roles)}"
    if of_robot and of_robot != robot:
        return f"it is of robot {of_robot!r}, and this is robot {robot!r}"
    if role == WORKER and not process.startswith(f"{owner}-"):
        return f"it is of the processes {owner}-0, {owner}-1 and so on, and this is {process}"
    return ""


def roles_that_ask(key: str) -> list[str]:
    return [role for role, rights in _ROLES.items() if key in rights.asks]


def access_control(robots: Sequence[str], workers: Sequence[str]) -> dict[str, Any]:
    """Return Zenoh's ``access_control`` section; the default is deny.

    Without `robots`, a certificate named after its role is valid for every robot. With `robots`,
    ``ROLE.ROBOT`` is valid for that robot alone; only ``viewer`` and ``operator`` are then also
    valid without a robot's name, for all of `robots`.

    Args:
        robots: names of robots; empty: all robots.
        workers: names of worker certificates, ``worker`` or ``worker-NAME``. ``worker-NAME``
            covers `WORKER_PROCESSES` processes, ``worker-NAME-0`` and so on; ``worker`` covers
            all processes called ``worker-...``.

    Raises:
        SettingsError: a name is invalid, or one worker certificate would cover another's processes.
    """
    _check(robots, workers)
    names = (*_ROLES, *workers)
    certificates: list[tuple[str, str, Sequence[str]]]
    if robots:
        certificates = [(name, name, robots) for name in ("viewer", "operator")]
        certificates += [(f"{name}.{one}", name, (one,)) for one in robots for name in names]
    else:
        certificates = [(name, name, (ALL_ROBOTS,)) for name in names]
    rules: list[dict[str, Any]] = []
    policies, subjects = [], []
    for name, role, covered in certificates:
        made = list(_rules(name, role, covered))
        rules += made
        subjects.append({"id": name, "cert_common_names": [name]})
        policies.append({"subjects": [name], "rules": [rule["id"] for rule in made]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rules(name: str, role: str, robots: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Yield the rules of one certificate: one for each right and direction."""
    rights = widened = rights_of(WORKER if role not in _ROLES else role)
    if role not in _ROLES:
        numbers = ["$*"] if role == WORKER else range(WORKER_PROCESSES)
        # Other processes declare wider patterns (worker/*/report), which egress rules must match.
        rights = rights_of(WORKER, *(f"{role}-{number}" for number in numbers))
    for right in fields(Rights):
        own, others = getattr(rights, right.name), getattr(widened, right.name)
        incoming, outgoing = _FLOWS[right.name]
        for flow, messages, patterns in (
            ("ingress", incoming, own),
            ("egress", outgoing, others if right.name == "publishes" else own),
        ):
            if messages and patterns:
                yield {
                    "id": f"{name} {right.name}: {flow}",
                    "permission": "allow",
                    "flows": [flow],
                    "messages": list(messages),
                    "key_exprs": [f"{robot}/{key}" for robot in robots for key in patterns],
                }


def _check(robots: Sequence[str], workers: Sequence[str]) -> None:
    for name in (*robots, *workers):
        if not is_name(name):
            problem = f"{name!r} is not a valid name: use {name_rule()}"
            raise SettingsError(key="--robot" if name in robots else "--worker", problem=problem)
    for name in workers:
        if name != WORKER and not name.startswith(f"{WORKER}-"):
            raise SettingsError(f"--worker {name}: call it worker or worker-NAME")
        for other in workers:
            if other.startswith(f"{name}-"):
                raise SettingsError(
                    key="--worker",
                    problem=f"{name!r} would cover the processes of {other!r}, as {other}-0: "
                    f"give all of them names of one kind, such as worker-a and worker-b",
                )
