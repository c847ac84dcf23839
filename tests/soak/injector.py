"""Injects faults: signals to processes, cut links, malformed messages."""

import signal
from collections.abc import Callable, Sequence
from functools import partial

import psutil

from clustermcl.protocol import keys
from clustermcl.protocol.codec import decode
from clustermcl.protocol.steps import LaserReading, OdometryReading
from tests.integration.system.rubbish import PUBLISHED, SERVED, bad_readings, no_messages
from tests.soak.driver import KIDNAP_KEY
from tests.soak.fleet import COORDINATOR, ROBOT, WORKER, Fleet, Part
from tests.soak.observer import Observer
from tests.soak.schedule import RULES, DoneFault, Fault, Kind

TRY_FOR_S = 10.0
"""A fault whose victim is restarting is delayed for at most this time [s]."""
_SLICE_S = 0.1
"""Slow network: the router is stopped and continued in turns of this length [s]."""
_OPEN = {
    "both ways": {"to_router": False, "from_router": False},
    "to the router": {"to_router": False, "from_router": True},
    "from the router": {"to_router": True, "from_router": False},
}
"""Directions that stay open in each kind of cut."""


class Injector:
    """Injects each fault when it is due and ends it in time."""

    def __init__(self, faults: Sequence[Fault], fleet: Fleet, observer: Observer) -> None:
        self._waiting, self._fleet, self._observer = list(faults), fleet, observer
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
        rule, until_ns = RULES[fault.kind], now_ns + int(fault.lasts_s * 1e9)
        match rule.does:
            case "kill" | "kill both":
                both = (Kind.COORDINATOR_KILLED, Kind.WORKER_KILLED)
                kinds = both if rule.does == "kill both" else (fault.kind,)
                victims = [self._victim(RULES[kind].role, fault, now_ns) for kind in kinds]
                return [
                    DoneFault(kind, now_ns, now_ns, victim.own_name)
                    for kind, victim in zip(kinds, victims, strict=True)
                    if None not in victims
                    and victim
                    and self._signal(victim.process, signal.SIGKILL)
                ]
            case "freeze":
                frozen = self._victim(rule.role, fault, now_ns)
                if frozen is None or not self._freeze(frozen.process, fault, now_ns):
                    return []
                return [DoneFault(fault.kind, now_ns, until_ns, frozen.own_name)]
            case "cut":
                return self._cut(fault, rule.role, now_ns, until_ns)
        sent = self._send(fault.kind)
        return [DoneFault(fault.kind, now_ns, now_ns, sent)] if sent else []

    def _cut(self, fault: Fault, role: str, now_ns: int, until_ns: int) -> list[DoneFault]:
        """Cut the links of the leader, or of every other worker as if on another machine."""
        candidates = self._candidates(role)
        half = int(fault.choice * 6) % 2
        victims = candidates[half::2] if role == WORKER else candidates
        if not victims or not self._cut_off.isdisjoint(one.process.pid for one in candidates):
            return []  # two simultaneous cuts could leave no worker
        pids = [victim.process.pid for victim in victims]
        how = list(_OPEN)[int(fault.choice * len(_OPEN))]
        self._fleet.set_cables(pids, **_OPEN[how])
        self._cut_off.update(pids)
        self._later.append((until_ns, partial(self._mend, pids)))
        names = " ".join(victim.own_name for victim in victims)
        return [DoneFault(fault.kind, now_ns, until_ns, names, how)]

    def _mend(self, pids: Sequence[int]) -> None:
        self._fleet.set_cables(pids, to_router=True, from_router=True)
        self._cut_off -= set(pids)

    def _candidates(self, role: str) -> list[Part]:
        """Return the processes of a role; of the coordinators only the leader."""
        found = [part for part in self._fleet.parts() if part.role == role]
        if role == COORDINATOR:
            found = [part for part in found if part.own_name == self._observer.leader]
        return sorted(found, key=lambda part: part.name)

    def _victim(self, role: str, fault: Fault, now_ns: int) -> Part | None:
        candidates = self._candidates(role)
        if role == WORKER:
            busy = set(self._observer.trackers(now_ns))
            candidates = [part for part in candidates if part.own_name in busy]
        return candidates[int(fault.choice * len(candidates))] if candidates else None

    def _freeze(self, process: psutil.Process, fault: Fault, now_ns: int) -> bool:
        if process in self._stopped or not self._signal(process, signal.SIGSTOP):
            return False
        slices = [fault.lasts_s]
        if fault.kind is Kind.SLOW_NETWORK:
            slices = [_SLICE_S] * (2 * int(fault.lasts_s / _SLICE_S / 2) + 1)  # it ends running
        at_ns = now_ns
        for number, slice_s in enumerate(slices):
            at_ns += int(slice_s * 1e9)
            what = signal.SIGSTOP if number % 2 else signal.SIGCONT
            self._later.append((at_ns, partial(self._signal, process, what)))
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
        if kind is Kind.ROBOT_KIDNAPPED:
            self._observer.publish(KIDNAP_KEY, b"")
            return ROBOT
        messages = list(no_messages())
        if kind is Kind.WRONG_READINGS:
            seen = self._observer.seen
            if not {keys.LASER_READING, keys.ODOMETRY_READING, keys.SCAN} <= seen.keys():
                return ""
            laser = decode(seen[keys.LASER_READING], LaserReading)
            odometry = decode(seen[keys.ODOMETRY_READING], OdometryReading)
            messages = [*bad_readings(laser, odometry), (keys.SCAN, seen[keys.SCAN])]
        for key, payload in messages:
            if key in SERVED:
                self._observer.query(key, payload)
            if key in PUBLISHED:
                self._observer.publish(key, payload)
        return f"{len(messages)} messages"
