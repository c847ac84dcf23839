"""Runs a soak, from the first process to the last verdict."""

import faulthandler
import shutil
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
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
from tests.soak.injector import Injector, Targets
from tests.soak.leak_promise import NothingLeaks, open_without_namespace
from tests.soak.observer import Observer
from tests.soak.report import Progress, SoakResult
from tests.soak.schedule import Fault, Kind, planned

_TURN_S = 0.02
_ROUTER_WITHIN_S, _READY_WITHIN_S = 30.0, 120.0
_FIRST_FAULT_S, _LAST_FAULT_S = 5.0, 15.0
"""Fault-free time after the start, and before the end for recovery from the last fault [s]."""


@dataclass(frozen=True, kw_only=True)
class SoakOptions:
    minutes: float
    coordinators: int
    """One leads, the others are standbys."""
    rate_hz: float
    """Scans a second; each is a step."""
    world: str
    chaos: bool
    fault_every_s: float
    only: tuple[Kind, ...]
    """Kinds of faults to inject; empty: all."""
    keep: Path | None
    """Folder to which logs and flight recordings are copied."""


class NotReadyError(ClusterMclError):
    """The processes run, but the first search does not find all places."""


def run_soak(
    options: SoakOptions, settings: Settings, stop: StopFlag, progress: Progress
) -> SoakResult:
    if options.world == eight_rooms.__name__ and settings.belief.max_clusters < PLACES:
        raise SettingsError(
            key="belief.max_clusters",
            problem=f"belief.max_clusters = {settings.belief.max_clusters}: eight rooms alike need "
            f"{PLACES}; or choose another --world",
        )
    with temporary_folder() as folder, temporary_files_in(folder) as left:
        kept_in = folder / "kept"
        kept_in.mkdir()
        robot = _files_in(kept_in, meeting_in(folder, settings))
        fleet = Fleet(
            [robot], folder, world=options.world, rate_hz=options.rate_hz,
            coordinators=options.coordinators, cables=options.chaos,
        )  # fmt: skip
        soak = _Soak(options, robot, fleet, stop, progress)
        try:
            fleet.start()
            soak.run()
        finally:
            soak.injector.end_all()
            stop_s = fleet.stop()
            if options.keep is not None:
                for log in fleet.log_files():
                    shutil.copy(log, kept_in)
                shutil.copytree(kept_in, options.keep, dirs_exist_ok=True)
        clean_end = clean_end_verdict(
            fleet.exits,
            soak.result.faults,
            fleet.log_files(),
            processes_left(soak.known, folder),
            left,
            stop_s,
        )
    faulthandler.cancel_dump_traceback_later()  # all that can hang is closed
    soak.result.verdicts.append(clean_end)
    return soak.result


def _files_in(folder: Path, settings: Settings) -> Settings:
    return replace(
        settings,
        coordinator=replace(settings.coordinator, state_folder=str(folder / "state")),
        recorder=replace(settings.recorder, folder=str(folder / "flights")),
    )


class _Soak:
    """The loop that reads all messages and injects the faults."""

    def __init__(
        self,
        options: SoakOptions,
        robot: Settings,
        fleet: Fleet,
        stop: StopFlag,
        progress: Progress,
    ) -> None:
        self._options, self._robot, self._fleet = options, robot, fleet
        self._stop, self._progress = stop, progress
        self._observer, self._leaks = Observer(robot, options.world, stop), NothingLeaks()
        self.result = SoakResult(options, self._observer.outages.faults)
        self.known: set[psutil.Process] = set()
        self.injector = Injector(
            self._planned(),
            Targets(
                parts=fleet.parts,
                trackers=self._observer.trackers,
                leader=lambda: self._observer.leader,
                seen=self._observer.seen,
                set_cables=fleet.set_cables,
                publish=self._observer.publish,
                query=self._observer.query,
            ),
        )

    def run(self) -> None:
        observer, result = self._observer, self.result
        with closing(observer.node) as node:
            node.open(_ROUTER_WITHIN_S)
            self._wait_until_ready()
            with open_without_namespace(self._robot) as router:
                result.start_ns = result.end_ns = time.time_ns()
                observer.is_judging = True
                every = (
                    _Every(0.2, observer.ask_pose),
                    _Every(3.0, self._sample),
                    _Every(20.0, partial(self._leaks.count_router_keys, router)),
                    _Every(1.0, self._show),
                )
                until_ns = result.start_ns + int(self._options.minutes * 60e9)
                while (now_ns := time.time_ns()) < until_ns and not self._stop.is_set():
                    for fault in self.injector.tick(now_ns, result.start_ns):
                        result.faults.append(fault)
                        self._progress.on_fault(fault, result.at_s(fault.at_ns))
                    self._turn()
                    for timer in every:
                        timer.tick(now_ns)
        result.end_ns = time.time_ns()
        result.verdicts += [*observer.verdicts(result.end_ns), self._leaks.verdict()]

    def _wait_until_ready(self) -> None:
        deadline_s = time.monotonic() + _READY_WITHIN_S
        while not self._observer.is_ready:
            self._stop.check()
            self._turn()
            if time.monotonic() > deadline_s:
                raise NotReadyError(
                    f"the places were not found within {_READY_WITHIN_S:.0f} s; "
                    "the logs say why: --keep DIR keeps them"
                )

    def _planned(self) -> tuple[Fault, ...]:
        if not self._options.chaos:
            return ()
        return planned(
            self._robot.seed,
            first_s=_FIRST_FAULT_S,
            last_s=self._options.minutes * 60.0 - _LAST_FAULT_S,
            every_s=self._options.fault_every_s,
            only=self._options.only,
        )

    def _turn(self) -> None:
        self._fleet.poll()
        self._observer.turn(_TURN_S)

    def _sample(self) -> None:
        leader = self._observer.leader
        parts = self._fleet.parts()
        self._leaks.sample((part.name, part.process, part.own_name == leader) for part in parts)
        self.known.update(self._fleet.processes())

    def _show(self) -> None:
        elapsed_s = self.result.at_s(time.time_ns())
        self._progress.on_turn(elapsed_s, self._observer.summary, len(self.result.faults))


@dataclass
class _Every:
    period_s: float
    act: Callable[[], object]
    due_ns: int = 0

    def tick(self, now_ns: int) -> None:
        if now_ns >= self.due_ns:
            self.due_ns = now_ns + int(self.period_s * 1e9)
            self.act()
