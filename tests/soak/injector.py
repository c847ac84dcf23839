"""Injects faults: signals to processes, cut links, malformed messages."""

import signal
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import psutil

from clustermcl.protocol import keys
from clustermcl.protocol.codec import decode
from clustermcl.protocol.steps import LaserReading, OdometryReading
from tests.integration.system.rubbish import PUBLISHED, SERVED, bad_readings, no_messages
from tests.soak.driver import KIDNAP_KEY
from tests.soak.fleet import BRIDGE, COORDINATOR, ROBOT, ROUTER, WORKER, WORKERS, Part
from tests.soak.promises import DoneFault
from tests.soak.schedule import Fault, Kind

TRY_FOR_S = 10.0
"""A fault whose victim is restarting is delayed for at most this time [s]."""
_SLICE_S = 0.1
"""Slow network: the router is stopped and continued in turns of this length [s]."""

_KILLED = {
    Kind.WORKER_KILLED: WORKER,
    Kind.ALL_WORKERS_KILLED: WORKERS,
    Kind.COORDINATOR_KILLED: COORDINATOR,
    Kind.BRIDGE_KILLED: BRIDGE,
    Kind.ROUTER_KILLED: ROUTER,
}
_LINK_CUT = {Kind.WORKER_LINKS_CUT: WORKER, Kind.COORDINATOR_LINK_CUT: COORDINATOR}
_FROZEN = {
    Kind.WORKER_FROZEN: WORKER,
    Kind.COORDINATOR_FROZEN: COORDINATOR,
    Kind.ROBOT_FROZEN: ROBOT,
    Kind.ROUTER_FROZEN: ROUTER,
    Kind.SLOW_NETWORK: ROUTER,
}
_DIRECTIONS = {
    "both ways": {"to_router": False, "from_router": False},
    "to the router": {"to_router": False, "from_router": True},
    "from the router": {"to_router": True, "from_router": False},
}
"""Directions that stay open in each kind of cut."""


class SetCables(Protocol):
    def __call__(self, pids: Sequence[int], *, to_router: bool, from_router: bool) -> None:
        """Cut or mend the links of these processes."""


@dataclass(frozen=True)
class Targets:
    parts: Callable[[], list[Part]]
    trackers: Callable[[int], list[str]]
    """Names of the workers that track clusters at a time [ns]."""
    leader: Callable[[], str]
    """Name of the coordinator that leads."""
    seen: Mapping[str, bytes]
    """The newest well-formed message of each key."""
    set_cables: SetCables
    publish: Callable[[str, bytes], None]
    query: Callable[[str, bytes], None]


class Injector:
    """Injects each fault when it is due and ends it in time."""

    def __init__(self, faults: Sequence[Fault], targets: Targets) -> None:
        self._waiting, self._targets = list(faults), targets
        self._later: list[tuple[int, Callable[[], object]]] = []
        self._cut_off: set[int] = set()
        self._stopped: set[psutil.Process] = set()

    def tick(self, now_ns: int, start_ns: int) -> list[DoneFault]:
        for due in [item for item in self._later if item[0] <= now_ns]:
            self._later.remove(due)
            due[1]()
        done = []
        elapsed_s = (now_ns - start_ns) / 1e9
        while self._waiting and (fault := self._waiting[0]).at_s <= elapsed_s:
            begun = self._begin(fault, now_ns)
            if not begun and elapsed_s < fault.at_s + TRY_FOR_S:
                break
            done += begun
            self._waiting.pop(0)
        return done

    def end_all(self) -> None:
        self._later.clear()
        if self._cut_off:
            self._mend(sorted(self._cut_off))
        for process in list(self._stopped):
            self._signal(process, signal.SIGCONT)

    def _begin(self, fault: Fault, now_ns: int) -> list[DoneFault]:
        """Inject a fault; return nothing if there is no victim now."""
        if fault.kind is Kind.WORKER_AND_COORDINATOR_KILLED:
            together = (Kind.COORDINATOR_KILLED, Kind.WORKER_KILLED)
            return self._kill([replace(fault, kind=kind) for kind in together], now_ns)
        if fault.kind in _KILLED:
            return self._kill([fault], now_ns)
        if fault.kind in _FROZEN:
            victim = self._victim(_FROZEN[fault.kind], fault, now_ns)
            if victim is None or not self._freeze(victim.process, fault, now_ns):
                return []
            return [_done(fault, victim, now_ns)]
        if fault.kind in _LINK_CUT:
            return self._cut(fault, now_ns)
        sent = self._send(fault.kind)
        return [DoneFault(fault.kind, now_ns, now_ns, sent)] if sent else []

    def _kill(self, faults: Sequence[Fault], now_ns: int) -> list[DoneFault]:
        victims = [self._victim(_KILLED[fault.kind], fault, now_ns) for fault in faults]
        if None in victims:
            return []
        return [
            _done(fault, victim, now_ns)
            for fault, victim in zip(faults, victims, strict=True)
            if victim is not None and self._signal(victim.process, signal.SIGKILL)
        ]

    def _cut(self, fault: Fault, now_ns: int) -> list[DoneFault]:
        """Cut the links of the leader, or of every other worker as if on another machine."""
        role = _LINK_CUT[fault.kind]
        candidates = self._candidates(role)
        half = int(fault.choice * 6) % 2
        victims = candidates[half::2] if role == WORKER else candidates
        if not victims or not self._cut_off.isdisjoint(one.process.pid for one in candidates):
            return []  # two simultaneous cuts could leave no worker
        pids = [victim.process.pid for victim in victims]
        how = list(_DIRECTIONS)[int(fault.choice * len(_DIRECTIONS))]
        self._targets.set_cables(pids, **_DIRECTIONS[how])
        self._cut_off.update(pids)
        until_ns = now_ns + int(fault.lasts_s * 1e9)
        self._later.append((until_ns, partial(self._mend, pids)))
        names = " ".join(victim.own_name for victim in victims)
        return [DoneFault(fault.kind, now_ns, until_ns, names, how)]

    def _mend(self, pids: Sequence[int]) -> None:
        self._targets.set_cables(pids, to_router=True, from_router=True)
        self._cut_off -= set(pids)

    def _candidates(self, role: str) -> list[Part]:
        """Return the processes of a role; of the coordinators only the leader."""
        found = [part for part in self._targets.parts() if part.role == role]
        if role == COORDINATOR:
            found = [part for part in found if part.own_name == self._targets.leader()]
        return sorted(found, key=lambda part: part.name)

    def _victim(self, role: str, fault: Fault, now_ns: int) -> Part | None:
        candidates = self._candidates(role)
        if role == WORKER:
            busy = set(self._targets.trackers(now_ns))
            candidates = [part for part in candidates if part.own_name in busy]
        return candidates[int(fault.choice * len(candidates))] if candidates else None

    def _freeze(self, process: psutil.Process, fault: Fault, now_ns: int) -> bool:
        if process in self._stopped or not self._signal(process, signal.SIGSTOP):
            return False
        slices = [fault.lasts_s]
        if fault.kind is Kind.SLOW_NETWORK:
            slices = [_SLICE_S] * max(1, int(fault.lasts_s / _SLICE_S))
        at_ns = now_ns
        for number, slice_s in enumerate(slices):
            at_ns += int(slice_s * 1e9)
            what = signal.SIGSTOP if number % 2 else signal.SIGCONT
            self._later.append((at_ns, partial(self._signal, process, what)))
        if len(slices) % 2 == 0:
            self._later.append((at_ns, partial(self._signal, process, signal.SIGCONT)))
        return True

    def _signal(self, process: psutil.Process, number: signal.Signals) -> bool:
        (self._stopped.add if number is signal.SIGSTOP else self._stopped.discard)(process)
        try:
            process.send_signal(number)
        except psutil.NoSuchProcess:
            self._stopped.discard(process)
            return False
        return True

    def _send(self, kind: Kind) -> str:
        """Send wrong messages; return a summary, empty if no message was seen to be modified."""
        targets = self._targets
        if kind is Kind.ROBOT_KIDNAPPED:
            targets.publish(KIDNAP_KEY, b"")
            return ROBOT
        messages = list(no_messages())
        if kind is Kind.WRONG_READINGS:
            seen = targets.seen
            if not {keys.LASER_READING, keys.ODOMETRY_READING, keys.SCAN} <= seen.keys():
                return ""
            laser = decode(seen[keys.LASER_READING], LaserReading)
            odometry = decode(seen[keys.ODOMETRY_READING], OdometryReading)
            messages = [*bad_readings(laser, odometry), (keys.SCAN, seen[keys.SCAN])]
        for key, payload in messages:
            if key in SERVED:
                targets.query(key, payload)
            if key in PUBLISHED:
                targets.publish(key, payload)
        return f"{len(messages)} messages"


def _done(fault: Fault, victim: Part, now_ns: int) -> DoneFault:
    until_ns = now_ns + int(fault.lasts_s * 1e9)
    return DoneFault(fault.kind, now_ns, until_ns, victim.own_name)
