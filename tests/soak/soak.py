"""Runs a soak, from the first process to the last verdict."""

import faulthandler
import shutil
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import psutil
from msgspec.structs import replace

from clustermcl.commands.stack import meeting_in, temporary_folder
from clustermcl.protocol.errors import ClusterMclError, SettingsError
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.stop import StopFlag
from tests.soak.clean_end import clean_end_verdict, processes_left, temporary_files_in
from tests.soak.eight_rooms import PLACES, eight_rooms
from tests.soak.fleet import Fleet
from tests.soak.injector import Injector
from tests.soak.leak_promise import NothingLeaks
from tests.soak.observer import Observer
from tests.soak.promises import Verdict
from tests.soak.schedule import DoneFault, Fault

_TURN_S = 0.02
_ROUTER_WITHIN_S, _READY_WITHIN_S = 30.0, 120.0


@dataclass
class SoakResult:
    faults: list[DoneFault]
    start_ns: int = 0
    """End of the first search."""
    end_ns: int = 0
    verdicts: list[Verdict] = field(default_factory=list)

    @property
    def is_broken(self) -> bool:
        return any(verdict.kept is False for verdict in self.verdicts)

    def at_s(self, at_ns: int) -> float:
        return (at_ns - self.start_ns) / 1e9


class NotReadyError(ClusterMclError):
    """The processes run, but the first search does not find all places."""


def run_soak(
    settings: Settings,
    stop: StopFlag,
    show: Callable[[str], None],
    *,
    minutes: float,
    world: str,
    rate_hz: float,
    coordinators: int,
    faults: Sequence[Fault],
    keep: Path | None,
) -> SoakResult:
    """Run the processes for some minutes; `keep` is a folder for logs and flight recordings."""
    if world == eight_rooms.__name__ and settings.belief.max_clusters < PLACES:
        problem = f"belief.max_clusters = {settings.belief.max_clusters}: eight rooms alike need "
        raise SettingsError(f"{problem}{PLACES}; or choose another --world")
    with temporary_folder() as folder, temporary_files_in(folder) as left:
        kept_in = folder / "kept"
        kept_in.mkdir()
        robot = replace(
            meeting_in(folder, settings),
            coordinator=replace(settings.coordinator, state_folder=str(kept_in / "state")),
            recorder=replace(settings.recorder, folder=str(kept_in / "flights")),
        )
        fleet = Fleet([robot], folder, world=world, rate_hz=rate_hz, coordinators=coordinators)
        observer = Observer(robot, world, stop)
        soak = _Soak(observer, fleet, Injector(faults, fleet, observer), show)
        try:
            fleet.start()
            soak.run(minutes, stop)
        finally:
            soak.injector.end_all()
            stop_s = fleet.stop()
            if keep is not None:
                for log in fleet.log_files():
                    shutil.copy(log, kept_in)
                shutil.copytree(kept_in, keep, dirs_exist_ok=True)
        running = processes_left(soak.known, folder)
        clean_end = clean_end_verdict(
            fleet.exits, soak.result.faults, fleet.log_files(), running, left, stop_s
        )
    faulthandler.cancel_dump_traceback_later()  # all that can hang is closed
    soak.result.verdicts.append(clean_end)
    return soak.result


class _Soak:
    """The loop that reads all messages and injects the faults."""

    def __init__(
        self, observer: Observer, fleet: Fleet, injector: Injector, show: Callable[[str], None]
    ) -> None:
        self._observer, self._fleet, self.injector, self._show = observer, fleet, injector, show
        self._leaks, self._minutes = NothingLeaks(), 0.0
        self.result = SoakResult(observer.outages.faults)
        self.known: set[psutil.Process] = set()

    def run(self, minutes: float, stop: StopFlag) -> None:
        self._minutes = minutes
        observer, result = self._observer, self.result
        with closing(observer.node) as node:
            node.open(_ROUTER_WITHIN_S)
            deadline_s = time.monotonic() + _READY_WITHIN_S
            while not observer.is_ready:
                stop.check()
                self._turn()
                if time.monotonic() > deadline_s:
                    problem = f"the places were not found within {_READY_WITHIN_S:.0f} s"
                    raise NotReadyError(f"{problem}; the logs say why: --keep DIR keeps them")
            result.start_ns = result.end_ns = time.time_ns()
            observer.is_judging = True
            every = {
                0.2: observer.ask_pose,
                3.0: self._sample,
                30.0: self._show_progress,
            }
            due_ns = dict.fromkeys(every, 0)
            until_ns = result.start_ns + int(minutes * 60e9)
            while (now_ns := time.time_ns()) < until_ns and not stop.is_set():
                for fault in self.injector.tick(now_ns, result.start_ns):
                    result.faults.append(fault)
                    self._show_fault(fault)
                self._turn()
                for period_s, act in every.items():
                    if now_ns >= due_ns[period_s]:
                        due_ns[period_s] = now_ns + int(period_s * 1e9)
                        act()
        result.end_ns = time.time_ns()
        result.verdicts += [*observer.verdicts(result.end_ns), self._leaks.verdict()]

    def _turn(self) -> None:
        self._fleet.poll()
        self._observer.turn(_TURN_S)

    def _sample(self) -> None:
        leader = self._observer.leader
        parts = self._fleet.parts()
        self._leaks.sample((part.name, part.process, part.own_name == leader) for part in parts)
        self.known.update(self._fleet.processes())

    def _show_progress(self) -> None:
        minutes, faults = self.result.at_s(time.time_ns()) / 60, len(self.result.faults)
        now = f"{minutes:.1f} of {self._minutes:g} min"
        self._show(f"{now}: {self._observer.summary}, {faults} faults")

    def _show_fault(self, fault: DoneFault) -> None:
        lasts_s = (fault.until_ns - fault.at_ns) / 1e9
        lasts = f" for {lasts_s:.1f} s" if lasts_s else ""
        at_s = self.result.at_s(fault.at_ns)
        self._show(f"{at_s:7.1f} s  {fault.kind}{lasts}: {fault.target}")
