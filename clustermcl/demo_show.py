"""The options of a demo, checked before any process is started."""

from dataclasses import dataclass
from pathlib import Path
from typing import assert_never

import msgspec

from evaluation.recordings import counted_steps
from evaluation.references import load_reference
from particle_filter.trajectory import Trajectory
from process_runtime.settings import Settings
from process_runtime.sources import SIMULATED, Live, Recorded, Simulated, parsed_source
from protocol.errors import SettingsError
from recordings.map_file import load_map_with_obstacles, map_file_of
from robot_simulator.free_space import FreeSpace
from robot_simulator.source import simulated_world

DEFAULT_SOURCE = f"{SIMULATED}cross_feature"
SIMULATION_RATE = 0.0
"""In a terminal: as fast as the workers follow, so that it takes seconds."""
VIEWED_RATE = 2.0
"""On a page: twice real time, about 3 steps a second."""
DEFAULT_SIMULATION_STEPS = 300
VIEWED_SIMULATION_STEPS = 10_000
"""On a page: about an hour, unless it is interrupted."""


@dataclass(frozen=True, kw_only=True)
class DemoOptions:
    """Options of the command."""

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
class Show:
    """A demo with checked options."""

    settings: Settings
    title: str
    steps: int | None
    """Known beforehand."""
    simulated: bool
    ends_when_localized: bool
    may_stand: bool
    """A person drives, and may leave it standing."""
    reference: Trajectory | None


def prepared(options: DemoOptions, settings: Settings) -> Show:
    """Read what can be refused before anything is started.

    Raises:
        ClusterMclError: an input cannot be used.
    """
    source = options.recording or _usual_source(options.map_file)
    match parsed_source(source):
        case Simulated() as robot:
            rate = VIEWED_RATE if options.view_at else SIMULATION_RATE
            rate = 1.0 if options.by_hand else rate
            settings = _played(source, rate, options, settings)
            return _simulated(robot, options, settings)
        case Recorded(path):
            rate = VIEWED_RATE if options.view_at else 0.0
            return _recorded(path, options, _played(source, rate, options, settings))
        case Live():
            problem = "--recording: a live robot has no end; start 'clustermcl up'"
            raise SettingsError(key="--recording", problem=problem)
        case choice:
            assert_never(choice)


def _usual_source(map_file: str | None) -> str:
    """A robot in the map that is named, by a path that is no world's name; else the story."""
    return f"{SIMULATED}{Path(map_file).absolute()}" if map_file else DEFAULT_SOURCE


def _played(source: str, usual_rate: float, options: DemoOptions, settings: Settings) -> Settings:
    """The settings of all processes of the demo; it keeps no state but in its own folder."""
    rate = usual_rate if options.rate is None else options.rate
    map_file = map_file_of(options.map_file or settings.bridge.map, source)
    bridge = msgspec.structs.replace(settings.bridge, source=source, rate=rate, map=map_file)
    not_the_robots = msgspec.structs.replace(settings.coordinator, state_folder="")
    return msgspec.structs.replace(settings, bridge=bridge, coordinator=not_the_robots)


def _simulated(robot: Simulated, options: DemoOptions, settings: Settings) -> Show:
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
    return Show(settings, title, steps, True, ends_when_localized, options.by_hand, None)


def _recorded(path: str, options: DemoOptions, settings: Settings) -> Show:
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
    return Show(settings, f"recording {path}", steps, False, False, False, reference)
