"""Runs a soak, from the first process to the last verdict."""

import shutil
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import msgspec
import psutil

from clustermcl.stack import meeting_in, temporary_folder
from process_runtime.settings import Settings
from process_runtime.stop import StopFlag
from protocol.errors import ClusterMclError, SettingsError
from robot_simulator.worlds.eight_rooms import PLACES, eight_rooms
from tests.soak.clean_end import clean_end_verdict, processes_left, temporary_files_in
from tests.soak.fleet import Fleet
from tests.soak.injector import Injector, Targets
from tests.soak.leak_promise import NothingLeaks, open_without_namespace
from tests.soak.listener import Listener
from tests.soak.observer import Observer
from tests.soak.promise import DoneFault, Verdict
from tests.soak.report import Progress, SoakResult
from tests.soak.schedule import Fault, Kind, planned
from zenoh_link.session import open_session

_TURN_S = 0.02
_READY_WITHIN_S = 120.0
_FIRST_FAULT_S, _LAST_FAULT_S = 5.0, 15.0
"""Fault-free time after the start, and before the end for recovery from the last fault [s]."""


@dataclass(frozen=True, kw_only=True)
class SoakOptions:
    """Options of a soak."""

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

    def __init__(self, *, waited_s: float) -> None:
        self.waited_s = waited_s
        super().__init__(
            f"the places were not found within {waited_s:.0f} s; "
            "the logs say why: --keep DIR keeps them"
        )


def run_soak(
    options: SoakOptions, settings: Settings, stop: StopFlag, progress: Progress
) -> SoakResult:
    """Run the processes, inject the faults and return the verdicts.

    Raises:
        NotReadyError: the robot did not find its first places.
        SettingsError: the world needs more clusters.
        StoppedError: stopped before there was anything to judge.
        ClusterMclError: an input cannot be used, or a process failed at its start.
    """
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
            soak.end_faults()
            stop_s = fleet.stop()
            if options.keep is not None:
                for log in fleet.log_files():
                    shutil.copy(log, kept_in)
                shutil.copytree(kept_in, options.keep, dirs_exist_ok=True)
        clean_end = clean_end_verdict(
            fleet.exits,
            soak.faults,
            fleet.log_files(),
            processes_left(soak.known, folder),
            left,
            stop_s,
        )
    return soak.result(clean_end)


def _files_in(folder: Path, settings: Settings) -> Settings:
    """Return the settings with state and flight recording in a folder."""
    coordinator = msgspec.structs.replace(settings.coordinator, state_folder=str(folder / "state"))
    recorder = msgspec.structs.replace(settings.recorder, folder=str(folder / "flights"))
    return msgspec.structs.replace(settings, coordinator=coordinator, recorder=recorder)


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
        self._observer, self._leaks = Observer(robot, options.world), NothingLeaks()
        self._injector: Injector | None = None
        self._verdicts: list[Verdict] = []
        self._start_ns = self._end_ns = 0
        self.known: set[psutil.Process] = set()

    @property
    def faults(self) -> list[DoneFault]:
        return self._observer.outages.faults

    def run(self) -> None:
        """Run until the time is over or the stop flag is set."""
        opened = partial(open_session, self._robot.zenoh, self._robot.robot, self._stop)
        with ExitStack() as sessions:
            listener = sessions.enter_context(closing(Listener(opened)))
            self._wait_until_ready(listener)
            router = sessions.enter_context(open_without_namespace(self._robot))
            self._start_ns, self._observer.is_judging = time.time_ns(), True
            self._injector = Injector(
                self._planned(),
                self._start_ns,
                Targets(
                    parts=self._fleet.parts,
                    trackers=self._observer.trackers,
                    leader=lambda: self._observer.leader,
                    seen=self._observer.seen,
                    set_cables=self._fleet.set_cables,
                    publish=listener.publish,
                    query=listener.query,
                ),
                self._robot.seed,
            )
            every = (
                _Every(0.2, listener.ask_pose),
                _Every(3.0, self._sample),
                _Every(20.0, partial(self._leaks.count_router_keys, router)),
                _Every(1.0, self._show),
            )
            until_ns = self._start_ns + int(self._options.minutes * 60e9)
            while (now_ns := time.time_ns()) < until_ns and not self._stop.is_set():
                self._inject(self._injector, now_ns)
                self._turn(listener)
                for timer in every:
                    timer.tick(now_ns)
                self._stop.wait(_TURN_S)
            self._turn(listener)
        self._end_ns = time.time_ns()
        self._verdicts = [*self._observer.verdicts(self._end_ns), self._leaks.verdict()]

    def end_faults(self) -> None:
        """Continue all frozen processes, and mend all links."""
        if self._injector is not None:
            self._injector.end_all()

    def result(self, clean_end: Verdict) -> SoakResult:
        """Return all verdicts, including that on the clean end."""
        self._stop.take_time()
        options: dict[str, object] = {
            name: value if isinstance(value, bool | int | float) else str(value)
            for name, value in asdict(self._options).items()
        }
        verdicts = [*self._verdicts, clean_end]
        return SoakResult(options, self._start_ns, self._end_ns, self.faults, verdicts)

    def _wait_until_ready(self, listener: Listener) -> None:
        deadline_s = time.monotonic() + _READY_WITHIN_S
        while not self._observer.is_ready:
            self._stop.check()
            self._turn(listener)
            if time.monotonic() > deadline_s:
                raise NotReadyError(waited_s=_READY_WITHIN_S)
            self._stop.wait(_TURN_S)

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

    def _inject(self, injector: Injector, now_ns: int) -> None:
        for fault in injector.tick(now_ns):
            self.faults.append(fault)
            self._progress.on_fault(fault, (fault.at_ns - self._start_ns) / 1e9)

    def _turn(self, listener: Listener) -> None:
        """Restart ended processes and read messages."""
        self._fleet.poll()
        for arrived in listener.arrived():
            self._observer.on_arrived(arrived)

    def _sample(self) -> None:
        leader = self._observer.leader
        parts = self._fleet.parts()
        self._leaks.sample((part.name, part.process, part.own_name == leader) for part in parts)
        self.known.update(self._fleet.processes())

    def _show(self) -> None:
        elapsed_s = (time.time_ns() - self._start_ns) / 1e9
        self._progress.on_turn(elapsed_s, self._observer.summary, len(self.faults))


class _Every:
    """Calls an action once a period.

    Args:
        period_s: between two calls.
        action: what to do.
    """

    def __init__(self, period_s: float, action: Callable[[], None]) -> None:
        self._period_ns, self._action = int(period_s * 1e9), action
        self._next_ns = 0

    def tick(self, now_ns: int) -> None:
        if now_ns >= self._next_ns:
            self._next_ns = now_ns + self._period_ns
            self._action()
