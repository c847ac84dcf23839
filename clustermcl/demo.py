"""The demo: everything on this machine, on a recording or a simulated robot, until its end."""

import os
import socket
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import assert_never

import msgspec
import zenoh
from rich.console import Console

from clustermcl.as_json import JsonObject, dumped, hypothesis_object, pose_object
from clustermcl.as_text import pose_text, spread_text
from clustermcl.demo_summary import DemoSummary
from clustermcl.demo_view import LineView, LiveView, NoView, View
from clustermcl.loudness import is_verbose
from clustermcl.record import recorded
from clustermcl.stack import Stack, meeting_in, running, temporary_folder
from clustermcl.view import page_address, say_link
from evaluation.judge import PoseError, pose_error
from evaluation.recordings import counted_steps
from evaluation.references import Reference, load_reference
from grid_maps.load import load_map_with_obstacles, map_file_of
from live_view.admission import Address
from process_runtime.logs import is_quiet
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
from protocol.pose_arrays import pose_tuple
from protocol.steps import TruePose
from robot_simulator.free_space import FreeSpace
from robot_simulator.source import simulated_world
from zenoh_link.inbox import Inbox
from zenoh_link.session import open_session
from zenoh_link.wire import Events, Received, Token, ask, subscribe, watch

DEFAULT_SOURCE = f"{SIMULATED}cross_feature"
SIMULATION_RATE = 0.0
"""Of the demo in a terminal: as fast as the workers follow, so that it is told in seconds."""
VIEWED_SIMULATION_RATE = 8.0 if (os.cpu_count() or 1) > 1 else 3.0
"""Of a robot that somebody looks at, for as long as they like: some 12 steps a second."""
DEFAULT_SIMULATION_STEPS = 300
VIEWED_SIMULATION_STEPS = 10_000
"""Of a robot that somebody looks at: about 15 minutes, if nobody ends it before."""
LOCALIZED_STEPS = 20
"""A simulated robot that has been localized for so long has shown what there is to see."""

_CONNECT_WITHIN_S = 20.0
_SILENCE_S = 60.0
_KEPT_TRUTHS = 64
_POLL_S = 0.05


class StalledError(ClusterMclError):
    """The processes run but nothing comes of it."""

    def __init__(self, *, silent_s: float) -> None:
        self.silent_s = silent_s
        super().__init__(f"no belief has come for {silent_s:.0f} s")


@dataclass(frozen=True, kw_only=True)
class DemoOptions:
    """What a person asked for."""

    recording: str | None = None
    """A recording's path, ``sim:WORLD`` or ``sim:MAP.yaml``; None: a robot in `map_file`, if
    that is named, else the default simulation."""
    map_file: str | None = None
    """None: that of the settings for a recording, the world's own for a simulated robot."""
    reference: Path | None = None
    rate: float | None = None
    steps: int | None = None
    """Steps of a simulated robot."""
    view_at: str | None = None
    """``HOST:PORT`` where a page draws it; None: nowhere."""
    record: Path | None = None
    """Where the run is recorded; None: nowhere."""
    by_hand: bool = False
    """A person drives the simulated robot, on that page."""
    as_json: bool = False


@dataclass(frozen=True)
class _Show:
    """What is going to be shown."""

    settings: Settings
    title: str
    steps: int | None
    """Known beforehand."""
    simulated: bool
    ends_when_localized: bool
    may_stand: bool
    """A person drives, and may leave it standing."""
    reference: Reference | None


@dataclass(frozen=True)
class _Result:
    summary: DemoSummary
    belief: Belief
    truth: PoseTuple | None
    status: Status


def run_demo(options: DemoOptions, settings: Settings) -> None:
    """Run a demo to its end and print what came of it.

    Raises:
        ClusterMclError: an input cannot be used, or a process failed.
        StoppedError: interrupted.
    """
    started_s = time.monotonic()
    if options.record is not None:
        check_output_file(options.record)
    page = None if options.view_at is None else _page_at(options.view_at)
    if page is None and options.by_hand:
        problem = "--drive: the robot is driven on the page: give --view, too"
        raise SettingsError(key="--drive", problem=problem)
    stop = stop_on_signals(exit_after_s=5.0)
    show = _prepared(options, settings)
    view = _view(options, show)
    with temporary_folder() as folder:
        arguments = ["--steps", str(show.steps)] if show.simulated else []
        arguments += ["--map", options.map_file] if show.simulated and options.map_file else []
        arguments += ["--by-hand"] if options.by_hand else []
        met = meeting_in(folder, show.settings)
        stack = Stack(
            met,
            folder,
            logs_in_folder=not is_verbose(),
            simulator_arguments=arguments,
            page_arguments=_page_arguments(options),
        )
        with running(stack):
            result = _run(stack, met, show, view, stop, options.record, page)
    wall_s = time.monotonic() - started_s
    if options.as_json:
        _print(dumped(_as_object(result, wall_s)))
    else:
        _print("\n".join(_summary(result, wall_s)))


def _page_arguments(options: DemoOptions) -> list[str] | None:
    if options.view_at is None:
        return None
    return ["--listen", options.view_at, *(["--by-hand"] if options.by_hand else [])]


def _page_at(view_at: str) -> Address:
    """Where a person is going to look.

    Raises:
        SettingsError: others would reach it: that wants a token, as of `clustermcl view`.
    """
    address = page_address(view_at)
    if not address.is_loopback or not address.port:
        problem = "--listen: a demo is shown on this machine alone, at a port that is named"
        raise SettingsError(key="--listen", problem=problem)
    return address


def _say_where(page: Address, check: Callable[[], None]) -> None:
    """Say what to open, once it can be."""
    while True:
        check()
        try:
            socket.create_connection((page.host, page.port), timeout=_POLL_S).close()
        except OSError:
            time.sleep(_POLL_S)
        else:
            say_link(f"http://{page.netloc}/")
            return


def _prepared(options: DemoOptions, settings: Settings) -> _Show:
    """Read what can be refused before anything is started."""
    source = options.recording or _usual_source(options.map_file)
    match parsed_source(source):
        case Simulated() as robot:
            rate = VIEWED_SIMULATION_RATE if options.view_at else SIMULATION_RATE
            rate = 1.0 if options.by_hand else rate
            settings = _played(source, rate, options, settings)
            return _simulated(robot, options, settings)
        case Recorded(path):
            return _recorded(path, options, _played(source, 0.0, options, settings))
        case Live():
            problem = "--recording: a live robot has no end; start 'clustermcl up'"
            raise SettingsError(key="--recording", problem=problem)
        case choice:
            assert_never(choice)


def _usual_source(map_file: str | None) -> str:
    """A robot in the map that is named, by a path that is no world's name; else the story."""
    return f"{SIMULATED}{Path(map_file).absolute()}" if map_file else DEFAULT_SOURCE


def _played(source: str, usual_rate: float, options: DemoOptions, settings: Settings) -> Settings:
    """The settings of all processes of the demo; nothing of it is kept."""
    rate = usual_rate if options.rate is None else options.rate
    map_file = map_file_of(options.map_file or settings.bridge.map, source)
    bridge = msgspec.structs.replace(settings.bridge, source=source, rate=rate, map=map_file)
    nothing_kept = msgspec.structs.replace(settings.coordinator, state_folder="off")
    return msgspec.structs.replace(settings, bridge=bridge, coordinator=nothing_kept)


def _simulated(robot: Simulated, options: DemoOptions, settings: Settings) -> _Show:
    if options.reference is not None:
        problem = "--reference: a simulated robot knows where it is; leave it out"
        raise SettingsError(key="--reference", problem=problem)
    FreeSpace(simulated_world(robot).truth)  # says if the robot fits nowhere
    if options.map_file:
        load_map_with_obstacles(options.map_file)
    usual_steps = VIEWED_SIMULATION_STEPS if options.view_at else DEFAULT_SIMULATION_STEPS
    steps = options.steps or usual_steps
    title = f"simulated robot in {robot.world}"
    ends_when_localized = options.steps is None and options.view_at is None
    return _Show(settings, title, steps, True, ends_when_localized, options.by_hand, None)


def _recorded(path: str, options: DemoOptions, settings: Settings) -> _Show:
    if options.by_hand:
        problem = "--drive: only a simulated robot can be driven; a recording has been"
        raise SettingsError(key="--drive", problem=problem)
    if options.steps is not None:
        problem = "--steps: only for a simulated robot; a recording has its own end"
        raise SettingsError(key="--steps", problem=problem)
    if not settings.bridge.map:
        problem = "--map is missing: a recording needs the map it was made in"
        raise SettingsError(key="--map", problem=problem)
    load_map_with_obstacles(settings.bridge.map)
    reference = load_reference(options.reference) if options.reference else None
    steps = counted_steps(path, settings.bridge)
    return _Show(settings, f"recording {path}", steps, False, False, False, reference)


def _view(options: DemoOptions, show: _Show) -> View:
    console = Console(stderr=options.as_json)
    steps = None if show.ends_when_localized else show.steps
    if is_quiet():
        return NoView()
    if console.is_terminal:
        return LiveView(console, show.title, steps)
    return NoView() if options.as_json else LineView(console, show.title)


def _run(
    stack: Stack,
    settings: Settings,
    show: _Show,
    view: View,
    stop: StopFlag,
    record: Path | None,
    page: Address | None,
) -> _Result:
    def check() -> None:
        stop.check()
        stack.check()

    stack.start_without_coordinator()
    try:
        if page is not None:
            _say_where(page, check)
        with (
            open_session(settings.zenoh, settings.robot, stop, wait_s=_CONNECT_WITHIN_S) as session,
            recorded(session, record),
            view,
        ):
            audience = _Audience(session, show, view, check)
            audience.wait_for_workers(settings.worker.count)
            stack.start_coordinator()
            summary = audience.follow()
            belief = summary.belief
            assert belief is not None  # the summary ends with one
            truth = audience.truth_of(belief)
            status = ask(session, keys.STATUS, Status, timeout_s=settings.zenoh.query_timeout_s)
            return _Result(summary, belief, truth, status)
    except UnreachableError:
        stack.check()  # whose last words say why
        raise


class _Audience:
    """Listens to the beliefs, and to the truth where there is one."""

    def __init__(
        self, session: zenoh.Session, show: _Show, view: View, check: Callable[[], None]
    ) -> None:
        self._show, self._view, self._check = show, view, check
        self._inbox: Events = Inbox({"belief": 4096, "events": 4096, "truth": 4096})
        self._alive: set[str] = set()
        self._truths: dict[int, PoseTuple] = {}
        self._summary = DemoSummary()
        subscribe(session, keys.BELIEF, self._inbox, "belief")
        subscribe(session, keys.EVENTS, self._inbox, "events")
        subscribe(session, keys.TRUTH, self._inbox, "truth")
        watch(session, keys.ALL_WORKERS_ALIVE, self._inbox)

    def wait_for_workers(self, count: int) -> None:
        """Wait until all are there: a step that nobody reports on would be lost."""
        while len(self._alive) < count:
            self._view.starting(len(self._alive), count)
            self._hear()
        self._view.starting(count, count)

    def follow(self) -> DemoSummary:
        """Hear beliefs until the last one."""
        heard_s = time.monotonic()
        while not self._over():
            if self._hear():
                heard_s = time.monotonic()
            elif time.monotonic() - heard_s > _SILENCE_S and not self._show.may_stand:
                raise StalledError(silent_s=_SILENCE_S)
        return self._summary

    def truth_of(self, belief: Belief) -> PoseTuple | None:
        """Where the robot was at the step of a belief; None where nobody knows."""
        if self._show.reference is not None:
            pose = self._show.reference.pose_at(belief.stamp_ns)
            return None if pose is None else pose_tuple(pose)
        deadline_s = time.monotonic() + 1.0
        while self._show.simulated and belief.step not in self._truths:
            if time.monotonic() > deadline_s:
                break
            self._hear()
        return self._truths.get(belief.step)

    def _over(self) -> bool:
        summary = self._summary
        if summary.belief is None:
            return False
        if self._show.ends_when_localized and summary.localized_steps >= LOCALIZED_STEPS:
            return True
        return summary.belief.last

    def _hear(self) -> bool:
        """Take what came, waiting a moment for it; whether it was a belief."""
        self._check()
        match self._inbox.get(_POLL_S):
            case Token(key=key, alive=alive):
                (self._alive.add if alive else self._alive.discard)(key)
            case Received(key=keys.TRUTH, payload=payload):
                truth = decode(payload, TruePose)
                self._truths[truth.step] = truth.map_from_robot
                while len(self._truths) > _KEPT_TRUTHS:
                    del self._truths[next(iter(self._truths))]
            case Received(key=keys.EVENTS, payload=payload):
                for numbered in decode(payload, JobEvents).events:
                    self._summary.on_event(numbered.event)
                    self._view.happened(numbered)
            case Received(key=keys.BELIEF, payload=payload):
                belief = decode(payload, Belief)
                self._summary.on_belief(belief)
                self._view.believed(belief, self._truths.get(belief.step))
                return True
        return False


def _error(result: _Result) -> PoseError | None:
    if result.truth is None or not result.belief.hypotheses:
        return None
    return pose_error(result.belief.hypotheses[0].mean, result.truth)


def _as_object(result: _Result, wall_s: float) -> JsonObject:
    belief, error = result.belief, _error(result)
    best = belief.hypotheses[0] if belief.hypotheses else None
    return {
        "state": belief.state,
        "pose": pose_object(best.mean, best.covariance) if best else None,
        "probability": best.probability if best else 0.0,
        "elsewhere_probability": belief.elsewhere_probability,
        "hypotheses": [hypothesis_object(hypothesis) for hypothesis in belief.hypotheses],
        "steps": result.status.steps_applied,
        "steps_lost": result.status.steps_lost,
        "wall_s": wall_s,
        "final_error_m": error.distance_m if error else None,
        "final_error_rad": error.heading_rad if error else None,
    }


def _summary(result: _Result, wall_s: float) -> list[str]:
    belief, error, status = result.belief, _error(result), result.status
    lines = list(result.summary.lines())
    if belief.hypotheses:
        best = belief.hypotheses[0]
        lines.append(
            f"In the end {belief.state} with probability {best.probability:.2f}: "
            f"{pose_text(best.mean)}  {spread_text(best.covariance)}"
        )
    else:
        lines.append(f"In the end {belief.state}, no place is held possible.")
    if error is not None:
        lines.append(f"That is {error.distance_m:.2f} m and {error.heading_deg:.1f} deg off.")
    lines.append(
        f"{status.steps_applied} steps, {status.steps_lost} lost, "
        f"{len(status.workers)} workers, {wall_s:.1f} s."
    )
    return lines


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()
