"""Injects faults: signals to processes, malformed messages."""

import signal
from collections.abc import Callable, Sequence
from functools import partial

import psutil

from tests.integration.system.rubbish import PUBLISHED, SERVED, no_messages
from tests.soak.driver import KIDNAP_KEY
from tests.soak.fleet import COORDINATOR, ROBOT, WORKER, Fleet, Part
from tests.soak.observer import Observer
from tests.soak.schedule import RULES, DoneFault, Fault, Kind

TRY_FOR_S = 10.0
"""A fault whose victim is restarting is delayed for at most this time [s]."""
_SLICE_S = 0.1
"""Slow network: the router is stopped and continued in turns of this length [s]."""


class Injector:
    """Injects each fault when it is due and ends it in time."""

    def __init__(self, faults: Sequence[Fault], fleet: Fleet, observer: Observer) -> None:
        self._waiting, self._fleet, self._observer = list(faults), fleet, observer
        self._later: list[tuple[int, Callable[[], object]]] = []
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
        for process in list(self._stopped):
            self._signal(process, signal.SIGCONT)

    def _begin(self, fault: Fault, now_ns: int) -> list[DoneFault]:
        """Inject a fault; return nothing if there is no victim now."""
        rule, until_ns = RULES[fault.kind], now_ns + int(fault.lasts_s * 1e9)
        match rule.does:
            case "send":
                return [DoneFault(fault.kind, now_ns, now_ns, self._send(fault.kind))]
            case "kill" if victim := self._victim(rule.role, fault, now_ns):
                is_done = self._signal(victim.process, signal.SIGKILL)
            case "freeze" if victim := self._victim(rule.role, fault, now_ns):
                is_done = self._freeze(victim.process, fault, now_ns)
            case _:
                return []
        return [DoneFault(fault.kind, now_ns, until_ns, victim.own_name)] if is_done else []

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
        """Send wrong messages; return a summary."""
        if kind is Kind.ROBOT_KIDNAPPED:
            self._observer.publish(KIDNAP_KEY, b"")
            return ROBOT
        messages = list(no_messages())
        for key, payload in messages:
            if key in SERVED:
                self._observer.query(key, payload)
            if key in PUBLISHED:
                self._observer.publish(key, payload)
        return f"{len(messages)} messages"
