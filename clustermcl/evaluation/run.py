"""One run of an algorithm on a robot's steps, simulated or recorded; several in parallel."""

import itertools
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias, TypeVar

import msgspec

from clustermcl.belief.outcome import Outcome
from clustermcl.evaluation.references import load_reference
from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.filter.settings import FilterSettings
from clustermcl.jobs import in_process
from clustermcl.jobs.map_model import sensor_model
from clustermcl.protocol.errors import ClusterMclError, MapFileError
from clustermcl.protocol.floors import ONE_MAP, Floors
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.recordings.recording import Recording, open_recording
from clustermcl.runtime.folders import kept_folder
from clustermcl.runtime.parent import die_with_parent
from clustermcl.runtime.settings import BridgeSettings, Settings
from clustermcl.runtime.sources import Simulated
from clustermcl.runtime.stop import StopFlag
from clustermcl.runtime.supervisor import use_one_thread_for_arithmetic
from clustermcl.sensor_bridge.recorded import steps_of
from clustermcl.simulator.simulation import Simulation, simulated_steps
from clustermcl.simulator.worlds.catalogue import simulated_world

TrueStep = tuple[Scan, PoseTuple | None]


class SimulatedRobot(msgspec.Struct, frozen=True, kw_only=True):
    """A robot to simulate."""

    world: str
    """Name of a world, or a map file."""
    map: Path | None = None
    """Map for the localizer; None: the world's own map."""
    floor: str = ""
    """Floor of `map` in which the robot drives, if that is a building and the world is not."""

    def simulation(self, seed: int) -> Simulation:
        """Return the robot in its world; a robot of another kind overrides it."""
        return Simulation(simulated_world(Simulated(self.world)), seed)


class RecordedRobot(msgspec.Struct, frozen=True, kw_only=True):
    """A recording of a robot, with its map and perhaps the ground truth."""

    recording: Path
    map: Path
    reference: Path | None = None
    """File with the ground truth; None: the ground truth is unknown, so no step is scored."""
    floor: str = ""
    """Floor of the ground truth, if `map` is a building."""

    def opened(self, settings: BridgeSettings) -> Recording:
        """Read the recording; a recording of another format overrides it."""
        return open_recording(self.recording, settings)


class Case(msgspec.Struct, frozen=True, kw_only=True):
    """A robot and the length of a run."""

    robot: SimulatedRobot | RecordedRobot
    updates: int | None = None
    """Largest number of steps; None: to the end of the recording."""


@dataclass(frozen=True)
class Course:
    """The steps of one run."""

    map: GridMap
    steps: Iterator[TrueStep]
    simulation: Simulation | None


def course_of(case: Case, seed: int, settings: BridgeSettings, start_step: int = 0) -> Course:
    """Begin a run; a file that cannot be used may raise its error only at the first step."""
    match case.robot:
        case SimulatedRobot() as robot:
            simulation = robot.simulation(seed)
            grid_map = load_map(robot.map) if robot.map else simulation.world.map
            known: Iterator[TrueStep] = simulated_steps(
                simulation, settings, grid_map, steps=case.updates
            )
            if robot.map:
                known = _in_atlas(known, grid_map.floors, robot, simulation.world.map.floors)
            return Course(grid_map, known, simulation)
        case RecordedRobot() as robot:
            grid_map = load_map(robot.map)
            reference = load_reference(robot.reference) if robot.reference else None
            recording = robot.opened(settings)
            scans = steps_of(recording, settings, grid_map.digest, grid_map.floors)
            end = None if case.updates is None else start_step + case.updates
            true_steps: Iterator[TrueStep] = (
                (scan, reference.pose_at(scan.stamp_ns) if reference else None)
                for scan in itertools.islice(scans, start_step, end)
            )
            if reference:
                true_steps = _in_atlas(true_steps, grid_map.floors, robot)
            return Course(grid_map, true_steps, None)


def _in_atlas(
    steps: Iterator[TrueStep],
    floors: Floors,
    robot: SimulatedRobot | RecordedRobot,
    of_world: Floors = ONE_MAP,
) -> Iterator[TrueStep]:
    """Return steps with true poses in the atlas of a building; those of a world are in its own.

    Raises:
        MapFileError: the robot's floor is none of the map.
    """
    try:
        for name in of_world.names or (robot.floor,):
            floors.in_atlas(name, (0.0, 0.0, 0.0))
    except ValueError as error:
        raise MapFileError(robot.map or "", f"--floor: {error}") from None
    on_floor = of_world.on_floor if of_world else lambda truth: (robot.floor, truth)
    return ((scan, truth and floors.in_atlas(*on_floor(truth))) for scan, truth in steps)


Outcomes = Callable[[Iterable[Scan], SensorModel, FilterSettings], Iterator[tuple[Scan, Outcome]]]

EstimatedStep: TypeAlias = tuple[Scan, Outcome, PoseTuple | None]

T = TypeVar("T")
R = TypeVar("R")

_POLL_S = 0.2


@dataclass(frozen=True, kw_only=True)
class Run:
    """One run of an algorithm; it can be sent to another process."""

    case: Case
    seed: int
    """Seed of the filter, in place of that of the settings, and of a simulated robot."""
    settings: Settings
    follow: Outcomes = in_process.outcomes
    start_step: int = 0
    """First step used of a recording, as if the robot had been switched on there."""

    def begun(self, cache_folder: Path | None = None) -> tuple[Course, Iterator[EstimatedStep]]:
        """Open all inputs; return the course, and an iterator over the steps.

        Likelihood fields are kept in `cache_folder`, or in the user's.
        """
        course = course_of(self.case, self.seed, self.settings.bridge, self.start_step)
        settings = msgspec.structs.replace(self.settings, seed=self.seed)
        folder = cache_folder or kept_folder("maps")
        try:
            model = sensor_model(course.map, settings.sensor, folder)
        except ValueError as error:  # the map has no obstacle
            raise MapFileError(self.case.robot.map or "", str(error)) from error
        scans, truths = itertools.tee(course.steps)
        followed = self.follow((scan for scan, _ in scans), model, settings)
        steps = zip(followed, truths, strict=True)
        return course, ((scan, outcome, truth) for (scan, outcome), (_, truth) in steps)


class RunError(ClusterMclError):
    """The process of a run was killed."""


def in_parallel(
    work: Callable[[T], R], pieces: Sequence[T], jobs: int, stop: StopFlag
) -> Iterator[tuple[int, R]]:
    """Call a function for each piece, in spawned processes of one thread; `stop` ends them.

    `work` must be a function of a module, so that it can be pickled.

    Yields:
        Index and result of each piece, in the order in which the calls return.

    Raises:
        RunError: the process of a call was killed. This, and any error that a call raises, ends
            the other calls.
    """
    use_one_thread_for_arithmetic()  # one process a core is enough; spawned ones inherit it
    pool = ProcessPoolExecutor(
        max(min(jobs, len(pieces)), 1),
        multiprocessing.get_context("spawn"),
        die_with_parent,
        (os.getpid(),),
    )
    try:
        # Ctrl-C reaches all processes of a terminal: those that start now leave it to this one.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
        running = {pool.submit(work, each): run for run, each in enumerate(pieces)}
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        while running and not stop.is_set():
            for future in wait(running, _POLL_S, FIRST_COMPLETED).done:
                yield running.pop(future), future.result()
    except BrokenProcessPool as error:
        raise RunError("a process ended in the middle of a run: is memory short?") from error
    finally:
        for child in multiprocessing.active_children():
            child.kill()
        pool.shutdown(cancel_futures=True)  # its thread has ended: at exit it would still write
