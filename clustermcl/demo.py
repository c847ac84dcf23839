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
import typer
import zenoh

from clustermcl.as_json import dumped
from clustermcl.demo_output import (
    DemoOutput,
    DemoSummary,
    result_lines,
    result_object,
)
from clustermcl.record import recorded
from clustermcl.stack import Stack, meeting_in, temporary_folder
from clustermcl.verbosity import is_verbose
from evaluation.references import load_reference
from live_view.admission import Address, parsed_address
from live_view.page_server import print_link
from particle_filter.trajectory import Trajectory
from process_runtime.output_files import check_output_file
from process_runtime.settings import Settings
from process_runtime.sources import SIMULATED, Live, Recorded, Simulated, parsed_source
from process_runtime.stop import StopFlag, stop_on_signals
from protocol import keys
from protocol.answers import Belief, Status
from protocol.codec import decode
from protocol.errors import ClusterMclError, SettingsError, UnreachableError
from protocol.job_events import JobEvents
from protocol.message import PoseTuple
from protocol.steps import TruePose
from recordings.map_file import load_map_with_obstacles, map_file_of
from robot_simulator.free_space import FreeSpace
from robot_simulator.robot import RADIUS_M
from robot_simulator.worlds.catalogue import simulated_world
from sensor_bridge.recorded import RecordedSource
from zenoh_link.inbox import Inbox
from zenoh_link.session import open_session
from zenoh_link.wire import Events, Publisher, Received, Token, ask, subscribe, watch

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

    settings: Settings
    title: str
    steps: int
    is_simulated: bool
    reference: Trajectory | None = None
    ends_when_localized: bool = False
    """Whether the demo ends after `LOCALIZED_STEPS` localized steps."""


def run_demo(options: DemoOptions, settings: Settings) -> None:
    """Run a demo to its end, and print the result; with a page, then wait for Ctrl-C."""
    if options.record is not None:
        check_output_file(options.record)
    page = None if options.view_at is None else _page_at(options.view_at)
    if page is None and options.by_hand:
        problem = "--drive needs --view: the robot is driven on the page"
        raise SettingsError(key="--drive", problem=problem)
    stop = stop_on_signals(exit_after_s=5.0)
    run, wandering = _prepared(options, settings), None
    if options.advised:
        alone = replace(options, advised=False, view_at=None, record=None)
        wandering = _run_to_end(alone, _prepared(alone, settings), None, stop, compared=True)
    _run_to_end(options, run, page, stop, wandering)


def _run_to_end(
    options: DemoOptions,
    run: _Run,
    page: Address | None,
    stop: StopFlag,
    wandering: DemoSummary | None = None,
    *,
    compared: bool = False,
) -> DemoSummary:
    """Run all processes to the last belief, and print the result.

    Args:
        options: options of the demo.
        run: its checked inputs.
        page: address of the page, or None.
        stop: ends the run.
        wandering: the run to compare with.
        compared: whether this is the run to compare with, which a JSON object does not show.
    """
    started_s = time.monotonic()
    by_hand = ["--by-hand"] if options.by_hand else []
    driven = ["--advised"] if options.advised else by_hand
    simulator = ["--steps", str(run.steps), *driven] if run.is_simulated else []
    simulator += ["--map", options.map_file] if run.is_simulated and options.map_file else []
    with temporary_folder() as folder:
        meeting = meeting_in(folder, run.settings)
        stack = Stack(
            meeting,
            folder,
            logs_in_folder=not is_verbose(),
            simulator_arguments=simulator,
            page_arguments=_page_arguments(page, run, by_hand) if page else None,
        )
        with closing(stack):
            text, summary = _followed(
                stack, meeting, run, options, page, stop, started_s, wandering
            )
            if not (compared and options.as_json):
                typer.echo(text)
            while page is not None:  # the page shows past steps until Ctrl-C
                _pause(stop, stack)
    return summary


def _followed(
    stack: Stack,
    meeting: Settings,
    run: _Run,
    options: DemoOptions,
    page: Address | None,
    stop: StopFlag,
    started_s: float,
    wandering: DemoSummary | None,
) -> tuple[str, DemoSummary]:
    """Start the processes, run until the last belief, and return the result as text."""
    stack.start_without_coordinator()
    wait_s = _CONNECT_WITHIN_S
    try:
        if page is not None:
            _wait_for_page(page, 0, stop, stack)
            print_link(f"http://{page.netloc}/")
        with open_session(meeting.zenoh, meeting.robot, stop, wait_s=wait_s) as session:
            output = DemoOutput(run.title, as_json=options.as_json)
            pause = functools.partial(_pause, stop, stack, 0.0)
            audience = _Audience(session, run, output, pause, may_stand=options.by_hand)
            with recorded(session, meeting, options.record), output.live():
                audience.wait_for_workers(meeting.worker.count or 1)
                if page is not None:
                    # Only then, so that the browser shows the first search.
                    _wait_for_page(page, 1, stop, stack)
                stack.start_coordinator()
                belief = audience.follow()
                truth = audience.truth_of(belief)
                timeout_s = meeting.zenoh.query_timeout_s
                status = ask(session, keys.STATUS, Status, timeout_s=timeout_s)
    except UnreachableError:
        stack.check()  # raises the error of a process that has ended, which is the cause
        raise
    wall_s = time.monotonic() - started_s
    summary = audience.summary
    if options.as_json:
        found = {} if wandering is None else {"wandering_found_step": wandering.found_step}
        result = result_object(belief, truth, status, wall_s, summary.found_step)
        return dumped({**result, **found}), summary
    lines = [*summary.lines(), *result_lines(belief, truth, status, wall_s)]
    if wandering is not None:
        step = wandering.found_step
        lines.append(f"The robot that wandered: {'never' if step is None else f'step {step}'}.")
    return "\n".join(lines), summary


class _Audience:
    """The receiver of beliefs, events and true poses, which passes them to the output."""

    def __init__(
        self,
        session: zenoh.Session,
        run: _Run,
        output: DemoOutput,
        check: Callable[[], None],
        *,
        may_stand: bool,
    ) -> None:
        self._run, self._output, self._check = run, output, check
        self._may_stand = may_stand
        self._inbox: Events = Inbox({"belief": 4096, "events": 4096, "truth": 4096})
        self._alive: set[str] = set()
        self._truths: dict[int, PoseTuple] = {}
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
        self._output.on_workers(are_ready=True)

    def follow(self) -> Belief:
        """Receive beliefs until the run ends, and return the last one."""
        received_s = time.monotonic()
        while True:
            if belief := self._receive():
                received_s = time.monotonic()
                is_found = self.summary.localized_steps >= LOCALIZED_STEPS
                if belief.last or (is_found and self._run.ends_when_localized):
                    return belief
            elif time.monotonic() - received_s > _SILENCE_S and not self._may_stand:
                raise StalledError(silent_s=_SILENCE_S)

    def truth_of(self, belief: Belief) -> PoseTuple | None:
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
        return self._truths.get(belief.step)

    def _receive(self) -> Belief | None:
        """Wait briefly for a message and handle the message; return it if it is a belief."""
        self._check()
        match self._inbox.get(_POLL_S):
            case Token(key=key, alive=alive):
                (self._alive.add if alive else self._alive.discard)(key)
            case Received(key=keys.TRUTH, payload=payload):
                truth = decode(payload, TruePose)
                self._truths[truth.step] = truth.pose
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
        truth = self._truths.get(belief.step)
        if self._truth is not None and (truth := self.truth_of(belief)) is not None:
            self._truth.put(TruePose(sender="demo", step=belief.step, pose=truth))
        self.summary.on_belief(belief, truth)
        self._output.on_belief(belief, truth)


def _prepared(options: DemoOptions, settings: Settings) -> _Run:
    """Check the inputs, before any process is started."""
    source = options.recording or _WORLD
    if options.map_file and not options.recording:  # has a "/", so it is no name of a world
        source = f"{SIMULATED}{Path(options.map_file).absolute()}"
    match parsed_source(source):
        case Simulated() as robot:
            rate = 1.0 if options.by_hand else _VIEWED_RATE if options.view_at else 0.0
            return _simulated(robot, options, _played(source, rate, options, settings))
        case Recorded(path):
            rate = _VIEWED_RATE if options.view_at else 0.0
            return _recorded(path, options, _played(source, rate, options, settings))
        case Live():
            problem = "--recording: a live robot has no end; start 'clustermcl up'"
            raise SettingsError(key="--recording", problem=problem)
        case choice:
            assert_never(choice)


def _played(source: str, usual_rate: float, options: DemoOptions, settings: Settings) -> Settings:
    rate = usual_rate if options.rate is None else options.rate
    map_file = map_file_of(options.map_file or settings.bridge.map, source)
    bridge = msgspec.structs.replace(settings.bridge, source=source, rate=rate, map=map_file)
    coordinator = msgspec.structs.replace(settings.coordinator, state_folder="")
    return msgspec.structs.replace(settings, bridge=bridge, coordinator=coordinator)


def _simulated(robot: Simulated, options: DemoOptions, settings: Settings) -> _Run:
    if options.reference is not None:
        problem = "--reference: a simulated robot knows where it is; leave it out"
        raise SettingsError(key="--reference", problem=problem)
    if options.by_hand and options.advised:
        problem = "--advised: the robot drives by itself, so leave out --drive"
        raise SettingsError(key="--advised", problem=problem)
    FreeSpace(simulated_world(robot).truth)  # raises if the robot fits nowhere
    if options.map_file:
        load_map_with_obstacles(options.map_file)
    radius_m = settings.robot.radius_m or RADIUS_M
    shown = msgspec.structs.replace(settings.robot, radius_m=radius_m)
    return _Run(
        msgspec.structs.replace(settings, robot=shown),
        f"simulated robot in {robot.world}{', advised' if options.advised else ''}",
        options.steps or (_VIEWED_STEPS if options.view_at else _STEPS),
        is_simulated=True,
        ends_when_localized=options.steps is None and options.view_at is None,
    )


def _recorded(path: str, options: DemoOptions, settings: Settings) -> _Run:
    if options.advised:
        problem = "--advised: only a simulated robot can follow advice, not a recording"
        raise SettingsError(key="--advised", problem=problem)
    if options.by_hand:
        problem = "--drive: only a simulated robot can be driven, not a recording"
        raise SettingsError(key="--drive", problem=problem)
    if options.steps is not None:
        problem = "--steps: only for a simulated robot; a recording is played to its end"
        raise SettingsError(key="--steps", problem=problem)
    if not settings.bridge.map:
        problem = "--map is missing: a recording needs the map it was made in"
        raise SettingsError(key="--map", problem=problem)
    load_map_with_obstacles(settings.bridge.map)
    reference = load_reference(options.reference) if options.reference else None
    steps = RecordedSource(path, settings.bridge).steps
    return _Run(settings, f"recording {path}", steps, is_simulated=False, reference=reference)


def _page_arguments(page: Address, run: _Run, by_hand: list[str]) -> list[str]:
    story = run.settings.bridge.source.removeprefix(SIMULATED) if run.is_simulated else "recording"
    return ["--listen", page.netloc, "--story", story, *by_hand]


def _page_at(view_at: str) -> Address:
    """Return the address of the page."""
    address = parsed_address(view_at)
    if not address.is_loopback or not address.port:
        problem = "--listen: a demo needs a loopback address and a port"
        raise SettingsError(key="--listen", problem=problem)
    return address


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
