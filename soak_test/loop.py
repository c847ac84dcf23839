"""The one loop that does everything and hears everything, between the first place and the end."""

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from functools import partial

import psutil
import zenoh

from process_runtime.settings import Settings
from process_runtime.stop import StopFlag
from protocol.errors import ClusterMclError
from soak_test.availability import DoneFault
from soak_test.fleet import Fleet, Part
from soak_test.injector import Injector, RobotSide
from soak_test.listener import Listener
from soak_test.options import SoakOptions
from soak_test.progress import Progress
from soak_test.report import SoakResult
from soak_test.resources import Resources
from soak_test.robot_checks import Promised, RobotChecks
from soak_test.router_keys import RouterKeys, open_plain
from soak_test.schedule import Fault, planned
from soak_test.verdict import Verdict, over_all
from zenoh_link.session import open_session

_TURN_S = 0.02
_READY_WITHIN_S, _READY_WITHIN_EACH_S = 120.0, 15.0
_FIRST_FAULT_S, _LAST_FAULT_S = 5.0, 15.0
"""After the start, and before the end: what the last fault broke has time to be mended."""


class NotReadyError(ClusterMclError):
    """The processes run, but a robot does not find its places."""

    def __init__(self, *, robots: Sequence[str], waited_s: float) -> None:
        self.robots, self.waited_s = tuple(robots), waited_s
        super().__init__(
            f"{', '.join(robots)}: its places were not found within {waited_s:.0f} s; "
            "their logs say why: --logs DIR keeps them"
        )


class Soak:
    """The processes, what is heard of them, and what is done to them."""

    def __init__(
        self,
        options: SoakOptions,
        robots: Sequence[Settings],
        fleet: Fleet,
        stop: StopFlag,
        progress: Progress,
    ) -> None:
        self._options, self._robots, self._fleet = options, robots, fleet
        self._stop, self._progress = stop, progress
        promised = Promised(
            rooms=options.rooms,
            delay_s=None if options.chaos else 1.0 / options.rate_hz,
            chaos=options.chaos,
        )
        self._checks = {one.robot.name: RobotChecks(one, promised) for one in robots}
        self._listeners: dict[str, Listener] = {}
        self._resources, self._router_keys = Resources(), RouterKeys()
        self._injector: Injector | None = None
        self.faults: list[DoneFault] = []
        self.known: set[psutil.Process] = set()
        self._verdicts: dict[str, Sequence[Verdict]] = {}
        self._start_ns = self._end_ns = 0

    def run(self) -> None:
        """Until the time is over, or told to stop; then everything heard is judged."""
        with ExitStack() as sessions:
            for one in self._robots:
                opened = partial(open_session, one.zenoh, one.robot, self._stop)
                self._listeners[one.robot.name] = sessions.enter_context(closing(Listener(opened)))
            plain = sessions.enter_context(open_plain(self._robots[0]))
            self._wait_until_ready()
            self._begin()
            self._keep_on(plain)
            self._judge()

    def wake_all(self) -> None:
        """Let everybody run who is frozen."""
        if self._injector is not None:
            self._injector.wake_all()

    def zombies(self) -> list[str]:
        """Dead processes that were not reaped for some seconds."""
        return sorted(self._resources.zombies)

    @property
    def heard(self) -> dict[str, dict[int, int]]:
        """Of each robot, by term the last step whose belief was heard."""
        return {name: checks.heard for name, checks in self._checks.items()}

    def result(self, of_the_end: Sequence[Verdict]) -> SoakResult:
        """Everything, with what could be told only when all had ended."""
        together = over_all(self._verdicts)
        together += [*self._resources.verdicts(), self._router_keys.verdict(), *of_the_end]
        return SoakResult(
            self._options,
            self._start_ns,
            self._end_ns,
            self.faults,
            together,
            self._verdicts,
            self._resources,
            {name: observer.clusters.changes for name, observer in self._checks.items()},
            {name: observer.status for name, observer in self._checks.items()},
        )

    def _wait_until_ready(self) -> None:
        """Until every robot has found its places and all workers are there."""
        allowed_s = _READY_WITHIN_S + _READY_WITHIN_EACH_S * len(self._robots)
        deadline_s = time.monotonic() + allowed_s
        while not all(observer.ready for observer in self._checks.values()):
            self._stop.check()
            self._turn()
            if time.monotonic() > deadline_s:
                waiting = [name for name, o in self._checks.items() if not o.ready]
                raise NotReadyError(robots=waiting, waited_s=allowed_s)
            self._stop.wait(_TURN_S)
            self._progress.starting(
                sum(observer.ready for observer in self._checks.values()), len(self._robots)
            )

    def _begin(self) -> None:
        self._start_ns = time.time_ns()
        for observer in self._checks.values():
            observer.judging = True
        sides = {
            name: RobotSide(
                trackers=observer.recovery.trackers,
                acting=observer.acting,
                seen=observer.seen,
                say=self._listeners[name].say,
                ask=self._listeners[name].ask_anything,
            )
            for name, observer in self._checks.items()
        }
        seed = self._robots[0].seed
        self._injector = Injector(
            self._planned(seed),
            self._start_ns,
            sides,
            self._fleet.parts,
            self._fleet.set_cables,
            seed,
        )

    def _planned(self, seed: int) -> tuple[Fault, ...]:
        if not self._options.chaos:
            return ()
        return planned(
            seed,
            first_s=_FIRST_FAULT_S,
            last_s=self._options.minutes * 60.0 - _LAST_FAULT_S,
            every_s=self._options.fault_every_s,
            only=self._options.only,
        )

    def _keep_on(self, plain: zenoh.Session) -> None:
        assert self._injector is not None  # `_begin` has made it
        until_ns = self._start_ns + int(self._options.minutes * 60e9)
        ask, status = _Every(0.2), _Every(2.0)
        sample, count, show = _Every(3.0), _Every(20.0), _Every(1.0)
        while (now_ns := time.time_ns()) < until_ns and not self._stop.is_set():
            for fault in self._injector.tick(now_ns):
                self._done(fault)
            self._turn()
            for listener in self._listeners.values():
                ask.due(now_ns, listener.ask_pose)
                status.due(now_ns, listener.ask_status)
            sample.due(now_ns, self._sample)
            count.due(now_ns, partial(self._router_keys.count, plain))
            show.due(now_ns, self._show)
            for timer in (ask, status, sample, count, show):
                timer.passed(now_ns)
            self._stop.wait(_TURN_S)
        self._router_keys.count(plain)

    def _done(self, fault: DoneFault) -> None:
        self.faults.append(fault)
        self._progress.fault(fault, (fault.at_ns - self._start_ns) / 1e9)
        for name, observer in self._checks.items():
            if fault.concerns(name):
                observer.fault(fault)

    def _turn(self) -> None:
        """Look after the processes and hear what came."""
        self._fleet.poll()
        for name, listener in self._listeners.items():
            for arrived in listener.arrived():
                self._checks[name].on_arrived(arrived)

    def _sample(self) -> None:
        parts = self._fleet.parts()
        self._resources.sample((part.name, part.process, self._acts(part)) for part in parts)
        everybody = self._fleet.processes()
        self._resources.look_for_zombies(everybody)
        self.known.update(everybody)

    def _acts(self, part: Part) -> bool:
        checks = self._checks.get(part.robot)
        return checks is not None and part.own_name == checks.acting()

    def _show(self) -> None:
        elapsed_s = (time.time_ns() - self._start_ns) / 1e9
        first = next(iter(self._checks.values()))
        self._progress.going_on(elapsed_s, first.summary, len(self.faults))

    def _judge(self) -> None:
        self._turn()
        self._end_ns = time.time_ns()
        self._verdicts = {
            name: observer.verdicts(self._end_ns) for name, observer in self._checks.items()
        }


class _Every:
    """Something that is done every so often, for each of several robots."""

    def __init__(self, period_s: float) -> None:
        self._period_ns = int(period_s * 1e9)
        self._next_ns = 0

    def due(self, now_ns: int, action: Callable[[], None]) -> None:
        """Do it if it is time."""
        if now_ns >= self._next_ns:
            action()

    def passed(self, now_ns: int) -> None:
        """The turn is over."""
        if now_ns >= self._next_ns:
            self._next_ns = now_ns + self._period_ns
