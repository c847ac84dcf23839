"""`clustermcl evaluate`: localize in one process as often as asked, and measure how well."""

import itertools
import json
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import msgspec
from rich.box import SIMPLE
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from clustermcl import in_process, ordinary_mcl
from clustermcl.metrics import Judge
from clustermcl.recordings import opened
from clustermcl.reference import load_reference
from grid_maps.grid_map import GridMap
from grid_maps.load import load_map
from particle_filter.settings import FilterSettings
from process_runtime.settings import Settings
from process_runtime.stop import StoppedError
from protocol.errors import MapFileError, SettingsError
from protocol.messages import PoseTuple, Scan
from robot_simulator.simulation import Simulation
from robot_simulator.source import PREFIX, SimulatedSource, simulated_steps, simulated_world
from sensor_bridge.step_maker import steps_of
from worker.map_model import default_cache_folder, sensor_model

ALGORITHMS = {"cluster-mcl": in_process.outcomes, "mcl": ordinary_mcl.outcomes}
DEFAULT_STEPS = 300
"""Of a simulated robot, which never stops by itself."""

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


def run_evaluate(options: EvaluateOptions, settings: Settings) -> None:
    """Run all seeds, print a table, and write the JSON where one is asked for.

    Raises:
        ClusterMclError: an input cannot be used.
        StoppedError: interrupted.
    """
    _refuse_what_does_not_fit(options)
    console = Console(stderr=True)
    _first_step(options, settings)  # says what is wrong before any process is started
    runs = _all_runs(options, settings, console)
    result = {
        "algorithm": options.algorithm,
        "recording": options.recording,
        "map": options.map_file,
        "runs": runs,
    }
    if options.json_file is not None:
        options.json_file.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    Console().print(_table(runs, f"{options.algorithm} on {options.recording}"))


def _refuse_what_does_not_fit(options: EvaluateOptions) -> None:
    if options.algorithm not in ALGORITHMS:
        known = " or ".join(ALGORITHMS)
        raise SettingsError(f"--algorithm {options.algorithm}: there is {known}")
    if options.simulated and (options.map_file or options.reference):
        raise SettingsError(
            f"{options.recording} has its own map and truth: leave --map, --reference out"
        )
    if not options.simulated and not options.map_file:
        raise SettingsError("--map is missing: a recording needs the map it was made in")
    if not options.simulated and options.kidnap_at is not None:
        raise SettingsError("--kidnap-at: only a simulated robot can be kidnapped")


def _all_runs(
    options: EvaluateOptions, settings: Settings, console: Console
) -> list[dict[str, Any]]:
    """Every seed in a process of its own, as many at a time as there are cores."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # for the children: seeds share the cores already
    seeds = range(settings.seed, settings.seed + options.seeds)
    jobs = min(options.jobs or os.cpu_count() or 1, options.seeds)
    runs: dict[int, dict[str, Any]] = {}
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"))
    try:
        with Progress(console=console, transient=True) as progress:
            bar = progress.add_task("runs", total=options.seeds)
            futures: list[Future[dict[str, Any]]] = [
                pool.submit(evaluated, options, settings, seed) for seed in seeds
            ]
            for future in as_completed(futures):
                run = future.result()
                runs[run["seed"]] = run
                progress.advance(bar)
    except KeyboardInterrupt:
        pool.shutdown(wait=False, cancel_futures=True)
        raise StoppedError from None
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    return [runs[seed] for seed in seeds]


def evaluated(options: EvaluateOptions, settings: Settings, seed: int) -> dict[str, Any]:
    """One run.

    Args:
        options: what to run on.
        settings: of filter and bridge.
        seed: of the filter, and of the simulated robot.

    Returns:
        Its entry in ``runs`` of the JSON.
    """
    settings = msgspec.structs.replace(settings, seed=seed)
    grid_map, steps = _course(options, settings)
    model = _sensor_model(options, grid_map, settings)
    truths: dict[int, PoseTuple | None] = {}
    judge = Judge()
    started_s = time.monotonic()
    for scan, outcome in ALGORITHMS[options.algorithm](
        _remembering(steps, truths), model, settings
    ):
        truth = truths.pop(scan.step)
        judge.take(scan.step, scan.stamp_ns, outcome.state, outcome.hypotheses, truth)
    return {"seed": seed, **asdict(judge.verdict()), "wall_s": time.monotonic() - started_s}


def _sensor_model(options: EvaluateOptions, grid_map: GridMap, settings: FilterSettings) -> Any:
    try:
        return sensor_model(grid_map, settings.sensor, default_cache_folder())
    except ValueError as error:
        raise MapFileError(options.map_file or options.recording, str(error)) from error


def _course(options: EvaluateOptions, settings: Settings) -> tuple[GridMap, Iterator[TrueStep]]:
    """The map, and the steps with the true poses."""
    if options.simulated:
        world = simulated_world(options.recording)
        simulation = Simulation(world, settings.seed)
        count = options.steps or DEFAULT_STEPS
        source = SimulatedSource(simulation, steps=count, kidnap_at=options.kidnap_at)
        return world.map, iter(simulated_steps(source, settings.bridge, world.map.digest))
    grid_map = load_map(options.map_file or "")
    scans = steps_of(opened(options.recording, settings.bridge), settings.bridge, grid_map.digest)
    return grid_map, itertools.islice(_with_reference(options, scans), options.steps)


def _with_reference(options: EvaluateOptions, scans: Iterator[Scan]) -> Iterator[TrueStep]:
    reference = load_reference(options.reference) if options.reference else None
    for scan in scans:
        pose = reference.pose_at(scan.stamp_ns) if reference else None
        yield scan, None if pose is None else (float(pose[0]), float(pose[1]), float(pose[2]))


def _remembering(steps: Iterator[TrueStep], truths: dict[int, PoseTuple | None]) -> Iterator[Scan]:
    """The scans alone, while the truth at each is put aside."""
    for scan, truth in steps:
        truths[scan.step] = truth
        yield scan


def _first_step(options: EvaluateOptions, settings: Settings) -> None:
    """Read every input as far as its first step."""
    grid_map, steps = _course(options, settings)
    _sensor_model(options, grid_map, settings)
    next(steps, None)


def _table(runs: list[dict[str, Any]], title: str) -> Table:
    right = sum(run["localized"] for run in runs)
    table = Table(box=SIMPLE, title=f"{title}: localized in {right} of {len(runs)}")
    columns: dict[str, Callable[[dict[str, Any]], str]] = {
        "seed": partial(_shown, "seed", "d"),
        "ok": lambda run: "yes" if run["localized"] else "no",
        "from step": partial(_shown, "localized_at_step", "d"),
        "error m": partial(_shown, "final_error_m", ".2f"),
        "rad": partial(_shown, "final_error_rad", ".3f"),
        "rmse m": partial(_shown, "rmse_m", ".3f"),
        "wrong>0.9": partial(_shown, "confidently_wrong_fraction", ".3f"),
        "tracked": partial(_shown, "truth_tracked_fraction", ".3f"),
        "p(truth)": partial(_shown, "truth_probability_mean", ".2f"),
        "steps": partial(_shown, "steps", "d"),
        "wall s": partial(_shown, "wall_s", ".1f"),
    }
    for name in columns:
        table.add_column(name, justify="right", no_wrap=True)
    for run in runs:
        table.add_row(*(shown(run) for shown in columns.values()))
    return table


def _shown(key: str, form: str, run: dict[str, Any]) -> str:
    return "-" if run[key] is None else format(run[key], form)
