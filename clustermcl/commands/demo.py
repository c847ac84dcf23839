"""`clustermcl demo`: localize a simulated robot or a recording, and summarize the run."""

import functools
import http.client
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import assert_never

import msgspec
import zenoh

from clustermcl.commands.demo_output import DemoOutput, DemoSummary
from clustermcl.commands.options import print_answer
from clustermcl.commands.record import recorded
from clustermcl.commands.stack import Stack, meeting_in, temporary_folder
from clustermcl.commands.verbosity import is_verbose
from clustermcl.evaluation.references import load_reference
from clustermcl.filter.motion.trajectory import Trajectory
from clustermcl.link.inbox import Inbox
from clustermcl.link.session import open_session
from clustermcl.link.wire import Events, Publisher, Received, Token, ask, subscribe, watch
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
class DemoOptions:
    """Options of `clustermcl demo`."""

    recording: str | None = None
    """A recording's path, ``sim:WORLD`` or ``sim:MAP.yaml``. None: a simulated robot in
    `map_file`, or in the default world."""
    map_file: str | None = None
    """Map file. None: for a recording, `bridge.map` of the settings or a map next to it; for a
    simulated robot, the map of its world."""
    reference: Path | None = None
    rate: float | None = None
    """Speed relative to real time; 0: as fast as possible. None: 1 if the robot is driven
    manually, otherwise 2 with a page and 0 without."""
    steps: int | None = None
    """Number of steps of a simulated robot; None: 300 at most, or 10,000 with a page."""
    view_at: str | None = None
    record: Path | None = None
    by_hand: bool = False
    advised: bool = False
    """First an equal robot wanders, without a page; then the robot drives advised ways."""
    as_json: bool = False


@dataclass(frozen=True)
class _Run:
    """A demo whose inputs are checked."""

    options: DemoOptions
    settings: Settings
    page: Address | None
    title: str
    simulator_arguments: tuple[str, ...] = ()
    reference: Trajectory | None = None

    @property
    def is_simulated(self) -> bool:
        return isinstance(parsed_source(self.settings.bridge.source), Simulated)

    def page_arguments(self) -> list[str] | None:
        if self.page is None:
            return None
        source = self.settings.bridge.source
        story = source.removeprefix(SIMULATED) if self.is_simulated else "recording"
        by_hand = ["--by-hand"] if self.options.by_hand else []
        return ["--listen", self.page.netloc, "--story", story, *by_hand]


def run_demo(options: DemoOptions, settings: Settings) -> None:
    """Run a demo to its end, and print the result; with a page, then wait for Ctrl-C."""
    if options.record is not None:
        check_output_file(options.record)
    run = _prepared(options, settings)
    stop, wandering = stop_on_signals(exit_after_s=5.0), None
    if options.advised:
        alone = replace(options, advised=False, view_at=None, record=None)
        wandering = _run_to_end(_prepared(alone, settings), stop, is_shown=not options.as_json)
    _run_to_end(run, stop, wandering)


def _run_to_end(
    run: _Run, stop: StopFlag, wandering: DemoSummary | None = None, *, is_shown: bool = True
) -> DemoSummary:
    """Run all processes to the last belief, print the result, and compare it with `wandering`."""
    started_s = time.monotonic()
    with temporary_folder() as folder:
        meeting = meeting_in(folder, run.settings)
        stack = Stack(
            meeting,
            folder,
            logs_in_folder=not is_verbose(),
            simulator_arguments=run.simulator_arguments,
            page_arguments=run.page_arguments(),
        )
        with closing(stack):
            try:
                summary, status = _followed(run, stack, meeting, stop)
            except UnreachableError:
                stack.check()  # raises the error of a process that has ended, which is the cause
                raise
            wall_s = time.monotonic() - started_s
            if is_shown:
                told = summary.as_object if run.options.as_json else summary.lines
                print_answer(told(status, wall_s, wandering))
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
    wait_s, timeout_s = _CONNECT_WITHIN_S, meeting.zenoh.query_timeout_s
    with open_session(meeting.zenoh, meeting.robot, stop, wait_s=wait_s) as session:
        output = DemoOutput(run.title, as_json=run.options.as_json)
        audience = _Audience(session, run, output, functools.partial(_pause, stop, stack, 0.0))
        with recorded(session, meeting, run.options.record), output.live():
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
            status = ask(session, keys.STATUS, Status, timeout_s=timeout_s)
    return audience.summary, status


class _Audience:
    """The receiver of beliefs, events and true poses, which passes them to the output."""

    def __init__(
        self,
        session: zenoh.Session,
        run: _Run,
        output: DemoOutput,
        check: Callable[[], None],
    ) -> None:
        self._run, self._output, self._check = run, output, check
        self._inbox: Events = Inbox({"belief": 4096, "events": 4096, "truth": 4096})
        self._alive: set[str] = set()
        self._truths: dict[int, TruePose] = {}
        self.summary = DemoSummary()
        self._truth = Publisher(session, keys.TRUTH) if run.reference else None
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
        ends_early = run.is_simulated and run.options.steps is None and run.page is None
        while True:
            if belief := self._receive():
                received_s = time.monotonic()
                is_found = self.summary.localized_steps >= LOCALIZED_STEPS
                if belief.last or (is_found and ends_early):
                    self.summary.truth = self._truth_of(belief)
                    return
            elif time.monotonic() - received_s > _SILENCE_S and not run.options.by_hand:
                raise StalledError(silent_s=_SILENCE_S)

    def _truth_of(self, belief: Belief) -> PoseTuple | None:
        """Return the true pose at the step of a belief; wait for it up to a second.

        None: unknown.
        """
        if self._run.reference is not None:
            return self._run.reference.pose_at(belief.stamp_ns)
        deadline_s = time.monotonic() + 1.0
        while self._run.is_simulated and belief.step not in self._truths:
            if time.monotonic() > deadline_s:
                break
            self._receive()
        return self._received_truth(belief)

    def _received_truth(self, belief: Belief) -> PoseTuple | None:
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
                self._on_belief(belief)
                return belief
        return None

    def _on_belief(self, belief: Belief) -> None:
        truth = self._received_truth(belief)
        if self._truth is not None and (truth := self._truth_of(belief)) is not None:
            self._truth.put(TruePose(sender="demo", step=belief.step, pose=truth))
        self.summary.on_belief(belief, truth)
        self._output.on_belief(belief, truth)


def _prepared(options: DemoOptions, settings: Settings) -> _Run:
    """Check the inputs, before any process is started."""
    page = None if options.view_at is None else parsed_address(options.view_at)
    if page is not None and not (page.is_loopback and page.port):
        raise SettingsError("--listen: a demo needs a loopback address and a port")
    source = options.recording or _WORLD
    if options.map_file and not options.recording:  # has a "/", so it is no name of a world
        source = f"{SIMULATED}{Path(options.map_file).absolute()}"
    rate, map_file = options.rate, options.map_file or settings.bridge.map
    if rate is None:
        rate = 1.0 if options.by_hand else _VIEWED_RATE if page else 0.0
    played = {"source": source, "rate": rate, "map": map_file_of(map_file, source)}
    bridge = msgspec.structs.replace(settings.bridge, **played)
    coordinator = msgspec.structs.replace(settings.coordinator, state_folder="")
    settings = msgspec.structs.replace(settings, bridge=bridge, coordinator=coordinator)
    match parsed_source(source):
        case Simulated() as robot:
            return _simulated(
                robot, _Run(options, settings, page, f"simulated robot in {robot.world}")
            )
        case Recorded(path):
            return _recorded(path, _Run(options, settings, page, f"recording {path}"))
        case Live():
            raise SettingsError("--recording: a live robot has no end; start 'clustermcl up'")
        case choice:
            assert_never(choice)


def _simulated(robot: Simulated, run: _Run) -> _Run:
    options, settings = run.options, run.settings
    if options.reference is not None:
        raise SettingsError("--reference: a simulated robot knows where it is; leave it out")
    if options.by_hand and options.advised:
        raise SettingsError("--advised: the robot drives by itself, so leave out --drive")
    FreeSpace(simulated_world(robot).truth)  # raises if the robot fits nowhere
    arguments = ["--steps", str(options.steps or (_VIEWED_STEPS if run.page else _STEPS))]
    if options.map_file:
        load_map_with_obstacles(options.map_file)
        arguments += ["--map", options.map_file]
    arguments += ["--by-hand"] if options.by_hand else []
    arguments += ["--advised"] if options.advised else []
    radius_m = settings.robot.radius_m or RADIUS_M
    shown = msgspec.structs.replace(settings.robot, radius_m=radius_m)
    return replace(
        run,
        settings=msgspec.structs.replace(settings, robot=shown),
        title=f"{run.title}{', advised' if options.advised else ''}",
        simulator_arguments=tuple(arguments),
    )


def _recorded(path: str, run: _Run) -> _Run:
    options, bridge = run.options, run.settings.bridge
    wrong = {
        "--advised: only a simulated robot can follow advice, not a recording": options.advised,
        "--drive: only a simulated robot can be driven, not a recording": options.by_hand,
        "--steps: only for a simulated robot; a recording is played to its end": options.steps,
        "--map is missing: a recording needs the map it was made in": not bridge.map,
    }
    for problem, is_wrong in wrong.items():
        if is_wrong:
            raise SettingsError(problem)
    load_map_with_obstacles(bridge.map)
    reference = load_reference(options.reference) if options.reference else None
    recorded_source(path, bridge)  # raises if no scan can be used
    return replace(run, reference=reference)


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
