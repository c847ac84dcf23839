"""`clustermcl demo`: localize a simulated robot or a recording, and summarize the run."""

import http.client
import time
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, assert_never

from clustermcl.commands import options as opt
from clustermcl.commands.demo_output import DemoOutput, DemoSummary
from clustermcl.commands.stack import Stack, meeting_in, temporary_folder
from clustermcl.commands.verbosity import is_verbose
from clustermcl.link.inbox import Inbox
from clustermcl.link.session import open_session
from clustermcl.link.wire import Events, Received, Token, ask, subscribe, watch
from clustermcl.protocol import keys
from clustermcl.protocol.answers import Belief, Status
from clustermcl.protocol.codec import decode
from clustermcl.protocol.errors import SettingsError, UnreachableError
from clustermcl.protocol.job_events import JobEvents
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import TruePose
from clustermcl.recordings.maps.map_file import load_map_with_obstacles, map_file_of
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import with_setting
from clustermcl.runtime.sources import NEED_MAP, SIMULATED, Live, Recorded, Simulated, parsed_source
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
    listen: opt.Listen = None,
    as_json: opt.AsJson = False,
) -> None:
    """Localize a simulated robot or a recording.

    All processes run on this machine, and end with the command.
    """
    opt.refuse_without("--view", view, listen=listen)
    page = parsed_address(listen or opt.HERE) if view else None
    if page is not None and not (page.is_loopback and page.port):
        raise SettingsError("--listen: a demo needs a loopback address and a port")
    source = recording or _WORLD
    if map_file and not recording:  # has a "/", so it is no name of a world
        source = f"{SIMULATED}{Path(map_file).absolute()}"
    usual_rate = _VIEWED_RATE if view else 0.0
    for name, value in (
        ("worker.count", workers),
        ("seed", seed),
        ("bridge.rate", usual_rate if rate is None else rate),
        ("bridge.source", source),
        ("bridge.map", map_file_of(map_file or settings.bridge.map, source)),
        ("coordinator.state_folder", ""),
    ):
        if value is not None:
            settings = with_setting(settings, name, value, "clustermcl demo")
    title, settings = _checked(settings, map_file, steps)
    is_simulated = isinstance(parsed_source(source), Simulated)
    story = source.removeprefix(SIMULATED) if is_simulated else "recording"
    robot = ["--steps", str(steps or (_VIEWED_STEPS if view else _STEPS))]
    robot += ["--map", map_file] if map_file else []
    viewed = ["--listen", page.netloc, "--story", story] if page else None
    stop, started_s = stop_on_signals(exit_after_s=5.0), time.monotonic()
    with temporary_folder() as folder:
        settings = meeting_in(folder, settings)
        stack = Stack(
            settings,
            folder,
            logs_in_folder=not is_verbose(),
            simulator_arguments=robot,
            page_arguments=viewed,
        )
        audience = _Audience(
            stack,
            stop,
            DemoOutput(title, as_json=as_json),
            has_truth=is_simulated,
            ends_early=is_simulated and steps is None and not view,
        )
        with closing(stack):
            try:
                status = audience.followed(settings, page)
            except UnreachableError:
                stack.check()  # raises the error of a process that has ended, which is the cause
                raise
            summary, wall_s = audience.summary, time.monotonic() - started_s
            opt.print_answer((summary.as_object if as_json else summary.lines)(status, wall_s))
            stop.check()
            while view:  # the page shows past steps until Ctrl-C
                audience.pause()


def _checked(settings: Settings, map_file: str | None, steps: int | None) -> tuple[str, Settings]:
    """Refuse what cannot be played; return the title, and the settings with the robot's radius."""
    bridge = settings.bridge
    match parsed_source(bridge.source):
        case Simulated() as simulated:
            FreeSpace(simulated_world(simulated).truth)  # raises if the robot fits nowhere
            if map_file:
                load_map_with_obstacles(map_file)
            radius_m = settings.robot.radius_m or RADIUS_M
            settings = with_setting(settings, "robot.radius_m", radius_m, "clustermcl demo")
            return f"simulated robot in {simulated.world}", settings
        case Recorded(path):
            wrong = {
                "--steps: only for a simulated robot; a recording is played to its end": steps,
                NEED_MAP: not bridge.map,
            }
            for problem, is_wrong in wrong.items():
                if is_wrong:
                    raise SettingsError(problem)
            load_map_with_obstacles(bridge.map)
            recorded_source(path, bridge)  # raises if no scan can be used
            return f"recording {path}", settings
        case Live():
            raise SettingsError("--recording: a live robot has no end; start 'clustermcl up'")
        case choice:
            assert_never(choice)


@dataclass(eq=False)
class _Audience:
    """The receiver of beliefs, events and true poses, which passes them to the output."""

    stack: Stack
    stop: StopFlag
    output: DemoOutput
    has_truth: bool
    ends_early: bool
    """The demo ends once the robot is localized."""
    summary: DemoSummary = field(default_factory=DemoSummary)
    _alive: set[str] = field(default_factory=set)
    _truths: dict[int, TruePose] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._inbox: Events = Inbox({"belief": 4096, "events": 4096, "truth": 4096})

    def followed(self, settings: Settings, page: Address | None) -> Status:
        """Run all processes to the last belief, and return their status."""
        self.stack.start_without_coordinator()
        if page is not None:
            self._wait_for_page(page, 0)
            print_link(f"http://{page.netloc}/")
        with open_session(settings.zenoh, settings.robot, self.stop, _CONNECT_WITHIN_S) as session:
            subscribe(session, keys.BELIEF, Belief, self._inbox, "belief")
            subscribe(session, keys.EVENTS, JobEvents, self._inbox, "events")
            subscribe(session, keys.TRUTH, TruePose, self._inbox, "truth")
            watch(session, keys.ALL_WORKERS_ALIVE, self._inbox)
            with self.output.live():
                # A step without reports would be lost.
                while len(self._alive) < (settings.worker.count or 1):
                    self.output.on_workers(are_ready=False)
                    self._receive()
                self.output.on_workers(are_ready=True, has_page=page is not None)
                if page is not None:  # only then, so that the browser shows the first search
                    self._wait_for_page(page, 1)
                self.stack.start_coordinator()
                try:
                    self._follow()
                except StoppedError:  # Ctrl-C ends a demo with a page: summarize what was seen
                    if self.summary.belief is None:
                        raise
                return ask(session, keys.STATUS, Status, timeout_s=settings.zenoh.query_timeout_s)

    def _follow(self) -> None:
        received_s = time.monotonic()
        while True:
            if belief := self._receive():
                received_s = time.monotonic()
                is_found = self.summary.localized_steps >= LOCALIZED_STEPS
                if belief.last or (is_found and self.ends_early):
                    self._wait_for_truth(belief)
                    return
            elif time.monotonic() - received_s > _SILENCE_S:
                problem = f"no belief has arrived for {_SILENCE_S:.0f} s"
                raise UnreachableError(peer="coordinator", problem=problem, waited_s=_SILENCE_S)

    def _wait_for_truth(self, belief: Belief) -> None:
        """Wait up to a second for the true pose at the step of the last belief."""
        deadline_s = time.monotonic() + 1.0
        while self.has_truth and belief.step not in self._truths:
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
        self.pause(0.0)
        match self._inbox.get(_POLL_S):
            case Token(key=key, alive=alive):
                (self._alive.add if alive else self._alive.discard)(key)
            case Received(key=keys.TRUTH, payload=payload):
                truth = decode(payload, TruePose)
                self._truths[truth.step] = truth
                while len(self._truths) > _KEPT_TRUTHS:
                    del self._truths[next(iter(self._truths))]
            case Received(key=keys.EVENTS, payload=payload):
                self.output.on_events(decode(payload, JobEvents).events)
            case Received(key=keys.BELIEF, payload=payload):
                belief = decode(payload, Belief)
                self.summary.on_belief(belief, self._truth_of(belief))
                self.output.on_belief(belief, self._truth_of(belief))
                return belief
        return None

    def pause(self, seconds: float = _POLL_S) -> None:
        """Wait; raise an error if the user pressed Ctrl-C or a process has ended."""
        self.stop.wait(seconds)
        self.stop.check()
        self.stack.check()

    def _wait_for_page(self, page: Address, least_browsers: int) -> None:
        """Wait until the page is served and at least this many browsers show it."""
        while True:
            connection = http.client.HTTPConnection(page.host, page.port, timeout=1.0)
            with closing(connection), suppress(OSError):
                connection.request("GET", "/browsers")
                if int(connection.getresponse().read()) >= least_browsers:
                    return
            self.pause()
