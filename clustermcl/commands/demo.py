"""`clustermcl demo`: localize a simulated robot or a recording, and summarize the run."""

import functools
import http.client
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, assert_never

import msgspec
import zenoh

from clustermcl.commands import options as opt
from clustermcl.commands.demo_output import DemoOutput, DemoSummary
from clustermcl.commands.record import recorded
from clustermcl.commands.stack import Stack, meeting_in, temporary_folder
from clustermcl.commands.verbosity import is_verbose
from clustermcl.link.inbox import Inbox
from clustermcl.link.session import open_session
from clustermcl.link.wire import Events, Received, Token, ask, subscribe, watch
from clustermcl.protocol import keys
from clustermcl.protocol.answers import Belief, Status
from clustermcl.protocol.codec import decode
from clustermcl.protocol.errors import ClusterMclError, SettingsError, UnreachableError
from clustermcl.protocol.job_events import JobEvents
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import TruePose
from clustermcl.recordings.maps.map_file import load_map_with_obstacles, map_file_of
from clustermcl.runtime.output_files import check_output_file
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import with_setting
from clustermcl.runtime.sources import SIMULATED, Live, Recorded, Simulated, parsed_source
from clustermcl.runtime.stop import StopFlag, StoppedError, stop_on_signals
from clustermcl.sensor_bridge.recorded import recorded_source
from clustermcl.simulator.free_space import FreeSpace
from clustermcl.simulator.robot import RADIUS_M
from clustermcl.simulator.worlds.catalogue import simulated_world
from clustermcl.view.admission import Address, parsed_address
from clustermcl.view.page_server import print_link

LOCALIZED_STEPS = 20
"""Number of localized steps after which the demo of a simulated robot ends, without a page."""
_WORLD = f"{SIMULATED}cross_feature"
_VIEWED_RATE = 2.0  # twice real time: about 3 steps per second
_STEPS, _VIEWED_STEPS = 300, 10_000  # of a simulated robot; with a page, about an hour
_CONNECT_WITHIN_S = 20.0
_SILENCE_S = 60.0
_KEPT_TRUTHS = 64
_POLL_S = 0.05


class StalledError(ClusterMclError):
    """No belief arrived for a long time although all processes run."""

    def __init__(self, *, silent_s: float) -> None:
        self.silent_s = silent_s
        super().__init__(f"no belief has arrived for {silent_s:.0f} s")


@dataclass(frozen=True, kw_only=True)
class _Run:
    """One run of a demo, whose inputs are checked."""

    settings: Settings
    robot: str
    map_file: str | None
    rate: float | None
    steps: int | None
    page: Address | None
    record: Path | None
    by_hand: bool
    advised: bool
    as_json: bool

    @property
    def is_simulated(self) -> bool:
        return isinstance(parsed_source(self.settings.bridge.source), Simulated)

    @property
    def title(self) -> str:
        return f"{self.robot}, advised" if self.advised else self.robot

    def played(self, folder: Path) -> Settings:
        """Return the settings of the processes: of the default rates, real time is 1."""
        usual = 1.0 if self.by_hand else _VIEWED_RATE if self.page else 0.0
        rate = usual if self.rate is None else self.rate
        bridge = msgspec.structs.replace(self.settings.bridge, rate=rate)
        return meeting_in(folder, msgspec.structs.replace(self.settings, bridge=bridge))

    def stack(self, settings: Settings, folder: Path) -> Stack:
        steps = self.steps or (_VIEWED_STEPS if self.page else _STEPS)
        by_hand = ["--by-hand"] if self.by_hand else []
        arguments = ["--steps", str(steps), *by_hand, *(["--advised"] if self.advised else [])]
        page = None
        if self.page is not None:
            source = settings.bridge.source
            story = source.removeprefix(SIMULATED) if self.is_simulated else "recording"
            page = ["--listen", self.page.netloc, "--story", story, *by_hand]
        return Stack(
            settings,
            folder,
            logs_in_folder=not is_verbose(),
            simulator_arguments=[*arguments, *(["--map", self.map_file] if self.map_file else [])],
            page_arguments=page,
        )


@opt.recording_command
def demo(
    settings: Settings,
    recording: Annotated[
        str | None, opt.option("Recording, or sim:WORLD, or sim:MAP.yaml.", "FILE")
    ] = None,
    map_file: Annotated[
        str | None, opt.option("Map of the recording or simulated robot.", "FILE", flag="--map")
    ] = None,
    workers: Annotated[int | None, opt.option("Number of worker processes.", min=1)] = None,
    rate: Annotated[
        float | None, opt.option("1: real time, 2: twice as fast, 0: as fast as possible.", min=0.0)
    ] = None,
    steps: Annotated[int | None, opt.option("Steps of a simulated robot.", min=1)] = None,
    seed: Annotated[int | None, opt.option("Seed of all random numbers.", min=0)] = None,
    view: Annotated[bool, opt.flag("--view", "Serve the live page, until Ctrl-C.")] = False,
    drive: Annotated[bool, opt.flag("--drive", "With --view: drive by the arrow keys.")] = False,
    advised: Annotated[
        bool, opt.flag("--advised", "After a robot that wanders, one advised.")
    ] = False,
    listen: opt.Listen = None,
    record: Annotated[Path | None, opt.option("Record the run (MCAP).", "FILE.mcap")] = None,
    as_json: opt.AsJson = False,
) -> None:
    """Localize a simulated robot or a recording.

    All processes run on this machine, and end with the command.
    """
    opt.refuse_without("--view", view, drive=drive, listen=listen)
    for name, value in (("worker.count", workers), ("seed", seed)):
        if value is not None:
            settings = with_setting(settings, name, value, "clustermcl demo")
    if record is not None:
        check_output_file(record)
    page = parsed_address(listen or opt.HERE) if view else None
    if page is not None and not (page.is_loopback and page.port):
        raise SettingsError("--listen: a demo needs a loopback address and a port")
    source = recording or _WORLD
    if map_file and not recording:  # has a "/", so it is no name of a world
        source = f"{SIMULATED}{Path(map_file).absolute()}"
    played = {"source": source, "map": map_file_of(map_file or settings.bridge.map, source)}
    bridge = msgspec.structs.replace(settings.bridge, **played)
    coordinator = msgspec.structs.replace(settings.coordinator, state_folder="")
    settings = msgspec.structs.replace(settings, bridge=bridge, coordinator=coordinator)
    match parsed_source(source):
        case Simulated() as simulated:
            robot = f"simulated robot in {simulated.world}"
            if drive and advised:
                raise SettingsError("--advised: the robot drives by itself, so leave out --drive")
            FreeSpace(simulated_world(simulated).truth)  # raises if the robot fits nowhere
            if map_file:
                load_map_with_obstacles(map_file)
            radius_m = settings.robot.radius_m or RADIUS_M
            shown = msgspec.structs.replace(settings.robot, radius_m=radius_m)
            settings = msgspec.structs.replace(settings, robot=shown)
        case Recorded(path):
            robot = f"recording {path}"
            _check_recorded(path, settings, drives=drive, advised=advised, steps=steps)
        case Live():
            raise SettingsError("--recording: a live robot has no end; start 'clustermcl up'")
        case choice:
            assert_never(choice)
    run = _Run(
        settings=settings,
        robot=robot,
        map_file=map_file,
        rate=rate,
        steps=steps,
        page=page,
        record=record,
        by_hand=drive,
        advised=advised,
        as_json=as_json,
    )
    stop, wandering = stop_on_signals(exit_after_s=5.0), None
    if advised:
        alone = replace(run, advised=False, page=None, record=None)
        wandering = _run_to_end(alone, stop, is_shown=not as_json)
    _run_to_end(run, stop, wandering)


def _check_recorded(
    path: str, settings: Settings, *, drives: bool, advised: bool, steps: int | None
) -> None:
    bridge = settings.bridge
    wrong = {
        "--advised: only a simulated robot can follow advice, not a recording": advised,
        "--drive: only a simulated robot can be driven, not a recording": drives,
        "--steps: only for a simulated robot; a recording is played to its end": steps,
        "--map is missing: a recording needs the map it was made in": not bridge.map,
    }
    for problem, is_wrong in wrong.items():
        if is_wrong:
            raise SettingsError(problem)
    load_map_with_obstacles(bridge.map)
    recorded_source(path, bridge)  # raises if no scan can be used


def _run_to_end(
    run: _Run, stop: StopFlag, wandering: DemoSummary | None = None, *, is_shown: bool = True
) -> DemoSummary:
    """Run all processes to the last belief, print the result, and compare it with `wandering`."""
    started_s = time.monotonic()
    with temporary_folder() as folder:
        meeting = run.played(folder)
        with closing(run.stack(meeting, folder)) as stack:
            try:
                summary, status = _followed(run, stack, meeting, stop)
            except UnreachableError:
                stack.check()  # raises the error of a process that has ended, which is the cause
                raise
            wall_s = time.monotonic() - started_s
            if is_shown:
                told = summary.as_object if run.as_json else summary.lines
                opt.print_answer(told(status, wall_s, wandering))
            stop.check()
            while run.page is not None:  # the page shows past steps until Ctrl-C
                _pause(stop, stack)
    return summary


def _followed(
    run: _Run, stack: Stack, meeting: Settings, stop: StopFlag
) -> tuple[DemoSummary, Status]:
    stack.start_without_coordinator()
    if run.page is not None:
        _wait_for_page(run.page, 0, stop, stack)
        print_link(f"http://{run.page.netloc}/")
    with open_session(meeting.zenoh, meeting.robot, stop, wait_s=_CONNECT_WITHIN_S) as session:
        output = DemoOutput(run.title, as_json=run.as_json)
        audience = _Audience(session, run, output, functools.partial(_pause, stop, stack, 0.0))
        with recorded(session, meeting, run.record), output.live():
            audience.wait_for_workers(meeting.worker.count or 1)
            if run.page is not None:
                # Only then, so that the browser shows the first search.
                _wait_for_page(run.page, 1, stop, stack)
            stack.start_coordinator()
            try:
                audience.follow()
            except StoppedError:  # Ctrl-C ends a demo with a page: summarize what was seen
                if audience.summary.belief is None:
                    raise
            timeout_s = meeting.zenoh.query_timeout_s
            status = ask(session, keys.STATUS, Status, timeout_s=timeout_s)
    return audience.summary, status


class _Audience:
    """The receiver of beliefs, events and true poses, which passes them to the output."""

    def __init__(
        self, session: zenoh.Session, run: _Run, output: DemoOutput, check: Callable[[], None]
    ) -> None:
        self._run, self._output, self._check = run, output, check
        self._inbox: Events = Inbox({"belief": 4096, "events": 4096, "truth": 4096})
        self._alive: set[str] = set()
        self._truths: dict[int, TruePose] = {}
        self.summary = DemoSummary()
        subscribe(session, keys.BELIEF, Belief, self._inbox, "belief")
        subscribe(session, keys.EVENTS, JobEvents, self._inbox, "events")
        subscribe(session, keys.TRUTH, TruePose, self._inbox, "truth")
        watch(session, keys.ALL_WORKERS_ALIVE, self._inbox)

    def wait_for_workers(self, count: int) -> None:
        """Wait until this many workers are ready, because a step without reports would be lost."""
        while len(self._alive) < count:
            self._output.on_workers(are_ready=False)
            self._receive()
        self._output.on_workers(are_ready=True, has_page=self._run.page is not None)

    def follow(self) -> None:
        run, received_s = self._run, time.monotonic()
        ends_early = run.is_simulated and run.steps is None and run.page is None
        while True:
            if belief := self._receive():
                received_s = time.monotonic()
                is_found = self.summary.localized_steps >= LOCALIZED_STEPS
                if belief.last or (is_found and ends_early):
                    self._wait_for_truth(belief)
                    return
            elif time.monotonic() - received_s > _SILENCE_S and not run.by_hand:
                raise StalledError(silent_s=_SILENCE_S)

    def _wait_for_truth(self, belief: Belief) -> None:
        """Wait up to a second for the true pose at the step of the last belief."""
        deadline_s = time.monotonic() + 1.0
        while self._run.is_simulated and belief.step not in self._truths:
            if time.monotonic() > deadline_s:
                break
            self._receive()
        self.summary.truth = self._truth_of(belief)

    def _truth_of(self, belief: Belief) -> PoseTuple | None:
        """Return the true pose at a step; None: it is unknown, or on another floor."""
        truth = self._truths.get(belief.step)
        return truth.pose if truth and truth.floor == belief.floor else None

    def _receive(self) -> Belief | None:
        """Wait briefly for a message and handle the message; return it if it is a belief."""
        self._check()
        match self._inbox.get(_POLL_S):
            case Token(key=key, alive=alive):
                (self._alive.add if alive else self._alive.discard)(key)
            case Received(key=keys.TRUTH, payload=payload):
                truth = decode(payload, TruePose)
                self._truths[truth.step] = truth
                while len(self._truths) > _KEPT_TRUTHS:
                    del self._truths[next(iter(self._truths))]
            case Received(key=keys.EVENTS, payload=payload):
                events = decode(payload, JobEvents).events
                self._output.on_events(events)
                for event in events:
                    self.summary.on_event(event)
            case Received(key=keys.BELIEF, payload=payload):
                belief = decode(payload, Belief)
                self.summary.on_belief(belief, self._truth_of(belief))
                self._output.on_belief(belief, self._truth_of(belief))
                return belief
        return None


def _pause(stop: StopFlag, stack: Stack, seconds: float = _POLL_S) -> None:
    """Wait; raise an error if the user pressed Ctrl-C or a process has ended."""
    stop.wait(seconds)
    stop.check()
    stack.check()


def _wait_for_page(page: Address, least_browsers: int, stop: StopFlag, stack: Stack) -> None:
    """Wait until the page is served and at least this many browsers show it."""
    while True:
        connection = http.client.HTTPConnection(page.host, page.port, timeout=1.0)
        with closing(connection), suppress(OSError):
            connection.request("GET", "/browsers")
            if int(connection.getresponse().read()) >= least_browsers:
                return
        _pause(stop, stack)
