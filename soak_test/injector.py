"""Does the faults: signals to processes, rubbish to keys. What is begun is ended in time."""

import signal
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import psutil

from soak_test import malformed
from soak_test.availability import DoneFault
from soak_test.fleet import BRIDGE, COORDINATOR, ROBOT, ROUTER, WORKER, WORKERS, Part
from soak_test.link_cuts import LinkCuts, SetCables
from soak_test.robot import KIDNAP_KEY
from soak_test.schedule import Fault, Kind

TRY_FOR_S = 10.0
"""A fault whose victim is just not there, being restarted, is put off for so long."""
_SLICE_S = 0.1
"""Of a slow network: the router stands still so long, runs so long, and so on."""

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


@dataclass(frozen=True)
class RobotSide:
    """What the injector needs of one robot."""

    trackers: Callable[[int], list[str]]
    """Names of the workers that track clusters now."""
    acting: Callable[[], str]
    """Name of the coordinator that acts."""
    seen: Mapping[str, bytes]
    """The newest good messages by key."""
    say: Callable[[str, bytes], None]
    ask: Callable[[str, bytes], None]


class Injector:
    """Told the time, does what is due."""

    def __init__(
        self,
        faults: Sequence[Fault],
        start_ns: int,
        robots: Mapping[str, RobotSide],
        parts: Callable[[], list[Part]],
        set_cables: SetCables,
        seed: int,
    ) -> None:
        self._waiting = list(faults)
        self._start_ns, self._robots, self._parts = start_ns, robots, parts
        self._rng = np.random.default_rng([seed, 0xBAD])
        self._later: list[tuple[int, Callable[[], object]]] = []
        self._cuts = LinkCuts(set_cables)
        self._stopped: set[psutil.Process] = set()
        self.skipped: list[Fault] = []

    def tick(self, now_ns: int) -> list[DoneFault]:
        """Do what is due; returns the faults that were begun."""
        for due in [item for item in self._later if item[0] <= now_ns]:
            self._later.remove(due)
            due[1]()
        done = []
        while self._waiting and self._at_ns(self._waiting[0]) <= now_ns:
            fault = self._waiting[0]
            begun = self._begin(fault, now_ns)
            if begun:
                done += begun
            elif now_ns < self._at_ns(fault) + TRY_FOR_S * 1e9:
                break
            else:
                self.skipped.append(fault)
            self._waiting.pop(0)
        return done

    def wake_all(self) -> None:
        """Let everybody run again who is frozen, and mend all cables."""
        self._later.clear()
        self._cuts.mend_all()
        for process in list(self._stopped):
            self._signal(process, signal.SIGCONT)

    def _at_ns(self, fault: Fault) -> int:
        return self._start_ns + int(fault.at_s * 1e9)

    def _begin(self, fault: Fault, now_ns: int) -> list[DoneFault]:
        """What was done; nothing where there is nobody to hit now."""
        robot = sorted(self._robots)[int(fault.choice * len(self._robots))]
        if fault.kind is Kind.WORKER_AND_COORDINATOR_KILLED:
            together = (Kind.COORDINATOR_KILLED, Kind.WORKER_KILLED)
            return self._kill([replace(fault, kind=kind) for kind in together], robot, now_ns)
        if fault.kind in _KILLED:
            return self._kill([fault], robot, now_ns)
        if fault.kind in _FROZEN:
            victim = self._victim(_FROZEN[fault.kind], robot, fault, now_ns)
            if victim is None or not self._freeze(victim.process, fault, now_ns):
                return []
            return [_done(fault, victim, now_ns)]
        if fault.kind in _LINK_CUT:
            return self._cut(fault, robot, now_ns)
        said = self._speak(fault.kind, self._robots[robot])
        return [DoneFault(fault.kind, now_ns, now_ns, robot, said)] if said else []

    def _kill(self, faults: Sequence[Fault], robot: str, now_ns: int) -> list[DoneFault]:
        """All of them, where each has somebody to hit; told one by one."""
        victims = [self._victim(_KILLED[fault.kind], robot, fault, now_ns) for fault in faults]
        hit = [
            (fault, victim)
            for fault, victim in zip(faults, victims, strict=True)
            if victim is not None
        ]
        if len(hit) < len(faults):
            return []
        return [
            _done(fault, victim, now_ns)
            for fault, victim in hit
            if self._signal(victim.process, signal.SIGKILL)
        ]

    def _cut(self, fault: Fault, robot: str, now_ns: int) -> list[DoneFault]:
        """Cut the links of one coordinator, or of every other worker: theirs is another machine."""
        role, share = _LINK_CUT[fault.kind], self._share(fault)
        everybody = self._candidates(role, robot)
        victims = everybody[int(share * 6) % 2 :: 2] if role == WORKER else everybody
        if not victims or self._cuts.any_cut_off([one.process.pid for one in everybody]):
            return []  # two cuts together could leave no worker
        pids = [victim.process.pid for victim in victims]
        how = self._cuts.cut(pids, share)
        until_ns = now_ns + int(fault.lasts_s * 1e9)
        self._later.append((until_ns, partial(self._cuts.mend, pids)))
        names = " ".join(victim.own_name for victim in victims)
        return [DoneFault(fault.kind, now_ns, until_ns, robot, names, how)]

    def _candidates(self, role: str, robot: str) -> list[Part]:
        """Processes of a role; of coordinators the one that acts."""
        owner = "" if role == ROUTER else robot
        found = [part for part in self._parts() if part.role == role and part.robot == owner]
        if role == COORDINATOR:
            acting = self._robots[robot].acting()
            found = [part for part in found if part.own_name == acting]
        return sorted(found, key=lambda part: part.name)

    def _share(self, fault: Fault) -> float:
        """Digits of the choice that have not chosen the robot."""
        return fault.choice * len(self._robots) % 1.0

    def _victim(self, role: str, robot: str, fault: Fault, now_ns: int) -> Part | None:
        candidates = self._candidates(role, robot)
        if role == WORKER:
            busy = set(self._robots[robot].trackers(now_ns))
            candidates = [part for part in candidates if part.own_name in busy]
        return candidates[int(self._share(fault) * len(candidates))] if candidates else None

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
        """Whether the process was there to get it."""
        (self._stopped.add if number is signal.SIGSTOP else self._stopped.discard)(process)
        try:
            process.send_signal(number)
        except psutil.NoSuchProcess:
            self._stopped.discard(process)
            return False
        return True

    def _speak(self, kind: Kind, side: RobotSide) -> str:
        """What was said; nothing where nothing has been heard yet that could be spoiled."""
        if kind is Kind.ROBOT_KIDNAPPED:
            side.say(KIDNAP_KEY, b"")
            return ROBOT
        if kind is Kind.WRONG_READINGS:
            messages = malformed.wrong_readings(side.seen)
        else:
            messages = malformed.malformed(self._rng, side.seen)
        for key, payload in messages:
            asked = key in malformed.ASKED
            if asked:
                side.ask(key, payload)
            if key in malformed.PUBLISHED:
                side.say(key, payload)
        return f"{len(messages)} messages" if messages else ""


def _done(fault: Fault, victim: Part, now_ns: int) -> DoneFault:
    until_ns = now_ns + int(fault.lasts_s * 1e9)
    return DoneFault(fault.kind, now_ns, until_ns, victim.robot, victim.own_name)
