"""One run of `clustermcl evaluate`: a robot's way, an algorithm, and the judge of its estimates."""

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import msgspec

from evaluation import in_process, ordinary_mcl
from evaluation.judge import Judge
from evaluation.references import load_reference
from grid_maps.grid_map import GridMap
from grid_maps.load import load_map
from particle_filter.sensor_model import SensorModel
from process_runtime.settings import Settings
from protocol.errors import MapFileError
from protocol.message import PoseTuple
from protocol.pose_arrays import pose_tuple
from protocol.steps import Scan
from robot_simulator.simulation import Simulation
from robot_simulator.source import PREFIX, SimulatedSource, simulated_steps, simulated_world
from sensor_bridge.recording import open_recording
from sensor_bridge.step_maker import steps_of
from worker.map_model import default_cache_folder, sensor_model

ALGORITHMS = {"cluster-mcl": in_process.outcomes, "mcl": ordinary_mcl.outcomes}
DEFAULT_STEPS = 300
"""Of a simulated robot, which never stops by itself."""
TOLD_EVERY_STEPS = 10

TrueStep = tuple[Scan, PoseTuple | None]


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions:
    """What a person asked for."""

    recording: str
    map_file: str | None = None
    reference: Path | None = None
    algorithm: str = "cluster-mcl"
    seeds: int = 1
    steps: int | None = None
    kidnap_at: int | None = None
    jobs: int | None = None
    json_file: Path | None = None

    @property
    def simulated(self) -> bool:
        """Whether the robot is a simulated one."""
        return self.recording.startswith(PREFIX)


@dataclass(frozen=True)
class Run:
    """What one run is made of; the settings' seed is also that of a simulated robot."""

    options: EvaluateOptions
    settings: Settings


def evaluated(run: Run, advanced: Callable[[int], None]) -> dict[str, Any]:
    """Do one run.

    Args:
        run: what to do.
        advanced: told now and then how many steps have been made since it was last.

    Returns:
        Its entry in ``runs`` of the JSON.
    """
    grid_map, steps = course(run)
    model = model_of(run, grid_map)
    truths: dict[int, PoseTuple | None] = {}
    judge = Judge()
    outcomes = ALGORITHMS[run.options.algorithm]
    started_s = time.monotonic()
    untold = 0
    for scan, outcome in outcomes(_remembering(steps, truths), model, run.settings):
        truth = truths.pop(scan.step)
        judge.on_step(scan.step, scan.stamp_ns, outcome.state, outcome.hypotheses, truth)
        untold += 1
        if untold == TOLD_EVERY_STEPS or scan.last:
            advanced(untold)
            untold = 0
    wall_s = time.monotonic() - started_s
    return {"seed": run.settings.seed, **asdict(judge.accuracy()), "wall_s": wall_s}


def steps_count(run: Run) -> int:
    """How many steps a run makes, having read every input as far as that takes.

    Raises:
        ClusterMclError: an input cannot be used.
    """
    grid_map, steps = course(run)
    model_of(run, grid_map)
    if run.options.simulated:
        next(steps)
        return run.options.steps or DEFAULT_STEPS
    return sum(1 for _ in steps)


def model_of(run: Run, grid_map: GridMap) -> SensorModel:
    """The map as the sensors see it, from the cache that all runs share.

    Raises:
        MapFileError: there is nothing in the map to measure against.
    """
    try:
        return sensor_model(grid_map, run.settings.sensor, default_cache_folder())
    except ValueError as error:
        raise MapFileError(run.options.map_file or run.options.recording, str(error)) from error


def course(run: Run) -> tuple[GridMap, Iterator[TrueStep]]:
    """The map to localize in, and the steps with the true poses.

    Raises:
        ClusterMclError: an input cannot be used; of a recording this may show at its first step.
    """
    options, bridge = run.options, run.settings.bridge
    if options.simulated:
        world = simulated_world(options.recording)
        simulation = Simulation(world, run.settings.seed)
        count = options.steps or DEFAULT_STEPS
        source = SimulatedSource(simulation, steps=count, kidnap_at=options.kidnap_at)
        grid_map = load_map(options.map_file) if options.map_file else world.map
        return grid_map, iter(simulated_steps(source, bridge, grid_map.digest))
    grid_map = load_map(options.map_file or "")
    scans = steps_of(open_recording(options.recording, bridge), bridge, grid_map.digest)
    return grid_map, itertools.islice(_with_reference(options, scans), options.steps)


def _with_reference(options: EvaluateOptions, scans: Iterator[Scan]) -> Iterator[TrueStep]:
    reference = load_reference(options.reference) if options.reference else None
    for scan in scans:
        pose = reference.pose_at(scan.stamp_ns) if reference else None
        yield scan, None if pose is None else pose_tuple(pose)


def _remembering(steps: Iterator[TrueStep], truths: dict[int, PoseTuple | None]) -> Iterator[Scan]:
    """The scans alone, while the truth at each is put aside."""
    for scan, truth in steps:
        truths[scan.step] = truth
        yield scan


def seeded(options: EvaluateOptions, settings: Settings) -> list[Run]:
    """A run for each seed, from that of the settings on."""
    first = settings.seed
    return [
        Run(options, msgspec.structs.replace(settings, seed=seed))
        for seed in range(first, first + options.seeds)
    ]
