"""How often is a robot called localized that is not on the map, and how often one that is?

Robots that are nowhere on their map: mirror images of recordings, recordings in foreign maps, and
robots in parts of a building that were not mapped. As controls, the same robots in
their own maps, among people, and with short-sighted lasers.

    python -m benchmarks.off_map [NAME...] [--cache FOLDER] [--baseline KEY=VALUE]

A NAME is part of a condition's or a group's name. The folder of recordings is that of
CLUSTERMCL_DATA. With a cache, the steps of every run are written there, so that models of
evidence can be fitted to them without running filters.
"""

import itertools
import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import typer

from benchmarks.experiments.case import Case, RecordedRobot
from benchmarks.experiments.catalogue import DATA_VARIABLE, recorded_cases
from benchmarks.people import CrowdSimulation
from benchmarks.same_views import Answer, answer_of
from benchmarks.worlds import world
from clustermcl.belief.outcome import Outcome
from clustermcl.evaluation.measures import CONFIDENT_PROBABILITY
from clustermcl.evaluation.run import TrueStep, course_of
from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN
from clustermcl.filter.kernels.compiled import to_cells
from clustermcl.jobs.in_process import InProcess
from clustermcl.jobs.map_model import sensor_model
from clustermcl.jobs.scan_arrays import scan_beams
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan, mirrored
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.runtime.folders import kept_folder
from clustermcl.runtime.settings import BridgeSettings, Settings
from clustermcl.runtime.settings_file import load_settings
from clustermcl.simulator.sensors import LidarModel
from clustermcl.simulator.simulation import Simulation, simulated_steps
from clustermcl.simulator.worlds.world import World

STEPS, STEPS_OF_A_START = 160, 60
WEAN = ("wean-1", "wean-2", "wean-3")
FOREIGN = (
    ("fr079", "intel"), ("wean-3", "aces"), ("fr101", "wean-1"), ("wean-1", "intel"),
    ("intel", "wean-1"), ("aces", "intel"), ("fhw", "wean-1"), ("edmonton", "intel"),
    ("belgioioso", "fr101"), ("intel", "fr079"), ("fr079", "fr101"), ("aces", "belgioioso"),
    ("edmonton", "fhw"),
)  # fmt: skip
"""A recording, and one whose map it is localized in."""
ERASED_SHARE, SQUARE_M = 0.4, 3.0
LIFTED_AT, LIFTED_STEPS = 40, 120
MOST_SDS = 5.0
WARM_UP_STEPS = 3
"""Not counted in CPU times: compiled kernels are loaded in them."""
KEPT_PLACES = 6
"""Of each step, in the cache."""

Steps = Iterator[tuple[Scan, PoseTuple | None, bool]]
"""A step, where the robot is, and whether that is on the map."""


@dataclass(frozen=True)
class Condition:
    """A robot and a map."""

    group: str
    name: str
    begin: Callable[[], tuple[GridMap, Steps]]
    steps: int = STEPS
    event_at: int | None = None
    """The robot was lifted before this step."""


class Row(msgspec.Struct, frozen=True):
    """One step of a run."""

    state: str
    probability: float
    """Of the most probable place."""
    right: bool
    on_map: bool
    truth: float
    """Probability of all right places."""
    none: float
    """Probability that the robot is at no tracked place."""
    off_map: float
    """Of that, that it is not on the map."""
    moved: tuple[float, float]
    error_m: float
    """Of the most probable place; NaN: the truth is unknown."""
    sds: float
    """The same error in the place's own standard deviations."""
    cpu_s: float
    """CPU time of the step."""
    places: list[tuple[float, PoseTuple, float]]
    """Probability, pose and fit [nat/beam] of the most probable ones."""
    mount: PoseTuple
    max_range_m: float
    beams: bytes
    """(B, 2) float64: ranges [m] and angles [rad]."""

    @property
    def localized(self) -> bool:
        """Called so."""
        return self.state == "localized"


class Result(msgspec.Struct, frozen=True):
    """A run."""

    group: str
    name: str
    event_at: int | None
    rows: list[Row]
    baseline_cpu_s: float
    """CPU time of the same steps with the baseline's settings, after the warm-up."""


# --- conditions


def conditions(data: Path | None) -> list[Condition]:
    """All that there are."""
    cases = {case.name: case for case in recorded_cases(data)}
    found = [*_of_recordings(cases), *_of_foreign_maps(cases), *_of_halves(cases)]
    return [*found, *_of_squares(), *_of_lifted(), *_of_disturbed(), *_of_starts(cases)]


def _of_recordings(cases: dict[str, Case]) -> Iterator[Condition]:
    for name, case in cases.items():
        kind = " (Wean)" if name in WEAN else ""
        yield Condition(f"mirrored{kind}", name, partial(_recorded, case, mirror=True))
        yield Condition(f"right map{kind}", name, partial(_recorded, case))
        yield Condition("whole recording", name, partial(_recorded, case), sys.maxsize)
    for name in ("hall", "office"):
        for seed in (1, 2):
            made = partial(_simulated, name, seed, mirror=True)
            yield Condition("mirrored, simulated", f"{name} {seed}", made)
            made = partial(_simulated, name, seed)
            yield Condition("right map, simulated", f"{name} {seed}", made)


def _of_foreign_maps(cases: dict[str, Case]) -> Iterator[Condition]:
    for robot, place in FOREIGN:
        if robot in cases and place in cases:
            map_file = _map_file(cases[place])
            for mirror in (False, True):
                group = "foreign map, mirrored" if mirror else "foreign map"
                made = partial(_foreign, cases[robot], map_file, mirror=mirror)
                yield Condition(group, f"{robot} in {place}", made)


def _of_halves(cases: dict[str, Case]) -> Iterator[Condition]:
    for name, seeds in (("hall", (1, 2, 3)), ("office", (1, 2, 3))):
        for seed in seeds:
            made = partial(_simulated, name, seed, change=without_right)
            yield Condition("half a map", f"{name} {seed}", made)
    for name in ("intel", "fr079", "belgioioso"):
        if name in cases:
            made = partial(_recorded_on_half, cases[name])
            yield Condition("half a map", name, made)


def _of_squares() -> Iterator[Condition]:
    for share in (0.1, 0.3):
        for seed in range(1, 9):
            change = partial(_with_squares, share=share, seed=seed)
            made = partial(_simulated, "hall", seed, change=change)
            yield Condition(f"{share:.0%} erased", f"hall {seed}", made)


def _of_lifted() -> Iterator[Condition]:
    for seed in range(1, 25):
        made = partial(_lifted, seed)
        yield Condition("lifted to a look-alike", str(seed), made, LIFTED_STEPS, LIFTED_AT)


def _of_disturbed() -> Iterator[Condition]:
    for seed in range(1, 9):
        made = partial(_simulated, "hall", seed, short=0.3)
        yield Condition("30 % short", str(seed), made, 100)
        lidar = LidarModel(beams=40, range_max_m=4.0)
        yield Condition("4 m, 40 beams", str(seed), partial(_simulated, "hall", seed, lidar), 100)
        yield Condition("hall", str(seed), partial(_simulated, "hall", seed), 100)
    for seed in range(1, 17):
        yield Condition("crowd", str(seed), partial(_simulated, "hall", seed, people=12), 100)


def _of_starts(cases: dict[str, Case]) -> Iterator[Condition]:
    for name, case in cases.items():
        kind = " (Wean)" if name in WEAN else ""
        for part in (0.2, 0.4, 0.6, 0.8):
            made = partial(_recorded, case, from_share=part)
            yield Condition(f"anywhere{kind}", f"{name} {part}", made, STEPS_OF_A_START)


def _map_file(case: Case) -> Path:
    assert isinstance(case.robot, RecordedRobot)
    return case.robot.map


def _recorded(
    case: Case, *, mirror: bool = False, from_share: float = 0.0
) -> tuple[GridMap, Steps]:
    bridge = BridgeSettings()
    first = 0
    if from_share:
        count = sum(1 for _ in course_of(case, 0, bridge).steps)
        first = round(from_share * (count - STEPS_OF_A_START))
    course = course_of(case, 0, bridge, first)
    return course.map, _shown(course.steps, course.map, mirror=mirror)


def _foreign(case: Case, map_file: Path, *, mirror: bool) -> tuple[GridMap, Steps]:
    course, grid_map = course_of(case, 0, BridgeSettings()), load_map(map_file)
    steps = ((_with_digest(scan, grid_map), None) for scan, _ in course.steps)
    return grid_map, _shown(steps, None, mirror=mirror)


def _recorded_on_half(case: Case) -> tuple[GridMap, Steps]:
    """From the first step on that is followed by twenty in the part that is erased."""
    course = course_of(case, 0, BridgeSettings())
    grid_map = without_right(course.map)
    steps = [
        (_with_digest(scan, grid_map), truth) for scan, truth in course.steps if truth is not None
    ]
    outside = [not _is_free(grid_map, truth) for _, truth in steps]
    first = next(i for i in range(len(steps)) if all(outside[i : i + 20]))
    return grid_map, _shown(iter(steps[first:]), grid_map)


def _simulated(
    name: str,
    seed: int,
    lidar: LidarModel | None = None,
    *,
    mirror: bool = False,
    change: Callable[[GridMap], GridMap] = lambda grid_map: grid_map,
    short: float = 0.0,
    people: int = 0,
) -> tuple[GridMap, Steps]:
    place = world(name)
    grid_map = change(place.map)
    start = start_in_right(place.map, seed) if change is without_right else None
    simulation = CrowdSimulation(place, seed, people, lidar, start)
    steps = simulated_steps(simulation, BridgeSettings(), grid_map)
    if short:
        steps = _cut_short(steps, short, seed)
    return grid_map, _shown(steps, grid_map, mirror=mirror)


def _lifted(seed: int) -> tuple[GridMap, Steps]:
    """To the place that looks alike but for furniture."""
    plain = world("hall_symmetric").map
    cells, rng = plain.cells.copy(), np.random.default_rng(seed)
    free = np.argwhere(plain.cells[:, : plain.cells.shape[1] // 2] == FREE)
    side = round(1.0 / plain.cell_m)
    for row, col in free[rng.integers(len(free), size=14)]:
        block = cells[row : row + side, col : col + side]
        block[block == FREE] = OCCUPIED
    furnished = GridMap(cells, plain.cell_m, plain.map_from_grid)
    place = World(map=furnished, truth=furnished)
    simulation = Simulation(place, seed)

    def steps() -> Iterator[TrueStep]:
        for count, step in enumerate(simulated_steps(simulation, BridgeSettings())):
            yield step
            if count + 1 == LIFTED_AT:
                x, y, heading = simulation.map_from_robot
                simulation.kidnap((-x, -y, heading + math.pi))

    return furnished, _shown(steps(), furnished)


def _shown(steps: Iterable[TrueStep], grid_map: GridMap | None, *, mirror: bool = False) -> Steps:
    for scan, truth in steps:
        if mirror or grid_map is None:
            yield mirrored(scan) if mirror else scan, None, False
        else:
            yield scan, truth, truth is None or _is_free(grid_map, truth)


def _with_digest(scan: Scan, grid_map: GridMap) -> Scan:
    return msgspec.structs.replace(scan, map_digest=grid_map.digest)


def _cut_short(steps: Iterator[TrueStep], share: float, seed: int) -> Iterator[TrueStep]:
    """Something stands in the way of a share of the beams, anywhere along them."""
    rng = np.random.default_rng([seed, 7])
    for scan, truth in steps:
        ranges = scan.ranges.array().astype(np.float64)
        ranges = np.where(np.isfinite(ranges), ranges, scan.range_max_m)
        cut = rng.random(len(ranges)) < share
        ranges = np.where(cut, ranges * rng.uniform(0.1, 1.0, len(ranges)), ranges)
        yield msgspec.structs.replace(scan, ranges=ArrayBlob.of(ranges, "float32")), truth


def without_right(grid_map: GridMap) -> GridMap:
    """The right two fifths were not mapped."""
    cells = grid_map.cells.copy()
    mapped = np.flatnonzero((cells != UNKNOWN).any(axis=0))
    first = mapped[0] + round((1.0 - ERASED_SHARE) * (mapped[-1] - mapped[0]))
    cells[:, first:] = UNKNOWN
    return GridMap(cells, grid_map.cell_m, grid_map.map_from_grid)


def start_in_right(grid_map: GridMap, seed: int) -> PoseTuple:
    rng = np.random.default_rng([seed, 11])
    free = np.argwhere(grid_map.cells == FREE)
    lost = free[~np.isin(free[:, 1], np.argwhere(without_right(grid_map).cells == FREE)[:, 1])]
    row, col = lost[rng.integers(len(lost))]
    x, y, _ = grid_map.map_from_grid
    heading = float(rng.uniform(-math.pi, math.pi))
    return (
        float(x + (col + 0.5) * grid_map.cell_m),
        float(y + (row + 0.5) * grid_map.cell_m),
        heading,
    )


def _with_squares(grid_map: GridMap, *, share: float, seed: int) -> GridMap:
    """Squares are made unknown until this share of the free ground is."""
    cells, rng = grid_map.cells.copy(), np.random.default_rng([seed, 13])
    side, free = round(SQUARE_M / grid_map.cell_m), np.count_nonzero(cells == FREE)
    while np.count_nonzero(cells == FREE) > (1.0 - share) * free:
        row, col = rng.integers(np.array(cells.shape) - side // 2)
        cells[row : row + side, col : col + side] = UNKNOWN
    return GridMap(cells, grid_map.cell_m, grid_map.map_from_grid)


def _is_free(grid_map: GridMap, pose: PoseTuple) -> bool:
    c, s, x0, y0 = to_cells(np.array(grid_map.map_from_grid), grid_map.cell_m)
    col, row = c * pose[0] - s * pose[1] + x0, s * pose[0] + c * pose[1] + y0
    rows, cols = grid_map.cells.shape
    inside = 0 <= row < rows and 0 <= col < cols
    return bool(inside and grid_map.cells[int(row), int(col)] != UNKNOWN)


# --- runs


class _Timed(InProcess):
    """Measures the CPU time of each step."""

    cpu_s = 0.0

    def timed(self, scan: Scan) -> Outcome:
        """Apply a step."""
        before_s = time.process_time()
        outcome = self.advance(scan)
        self.cpu_s = time.process_time() - before_s
        return outcome


def run(condition: Condition, settings: Settings, baseline: Settings | None = None) -> Result:
    """Localize.

    Args:
        condition: the robot and the map.
        settings: of the filter.
        baseline: the settings of a second filter, which has the same steps in turn; None: none.
    """
    grid_map, steps = condition.begin()
    model = sensor_model(grid_map, settings.sensor, kept_folder("maps"))
    process = _Timed(model, settings)
    other = _Timed(model, baseline) if baseline else None
    rows: list[Row] = []
    before, baseline_cpu_s = None, 0.0
    for scan, truth, on_map in itertools.islice(steps, condition.steps):
        if other is not None and len(rows) % 2:
            other.timed(scan)
        outcome = process.timed(scan)
        if other is not None:
            if not len(rows) % 2:
                other.timed(scan)
            baseline_cpu_s += other.cpu_s if len(rows) >= WARM_UP_STEPS else 0.0
        beams = scan_beams(scan, model)
        moved = (0.0, 0.0)
        if before is not None:
            turn = math.remainder(scan.odom_from_robot[2] - before[2], math.tau)
            moved = math.dist(scan.odom_from_robot[:2], before[:2]), abs(turn)
        before = scan.odom_from_robot
        rows.append(
            _row(
                outcome,
                truth,
                moved,
                on_map=on_map,
                process=process,
                mount=scan.robot_from_laser,
                beams=np.stack([beams.ranges, beams.angles], axis=-1),
                max_range_m=min(scan.range_max_m, settings.sensor.max_range_m),
            )
        )
    return Result(condition.group, condition.name, condition.event_at, rows, baseline_cpu_s)


def _row(
    outcome: Outcome,
    truth: PoseTuple | None,
    moved: tuple[float, float],
    *,
    on_map: bool,
    process: _Timed,
    mount: PoseTuple,
    beams: np.ndarray,
    max_range_m: float,
) -> Row:
    places = outcome.hypotheses
    nowhere = Answer(
        0.0, places[0].probability if places else 0.0, False, math.nan, math.nan, outcome.state
    )
    answer = nowhere if truth is None else answer_of(outcome, truth)
    return Row(
        state=outcome.state,
        probability=answer.best,
        right=answer.is_right,
        on_map=on_map,
        truth=answer.truth,
        none=outcome.elsewhere_probability,
        off_map=getattr(outcome, "off_map_probability", 0.0),
        moved=moved,
        error_m=answer.error_m,
        sds=answer.sds,
        cpu_s=process.cpu_s,
        places=[(p.probability, p.pose, 0.0) for p in places[:KEPT_PLACES]],
        mount=mount,
        max_range_m=max_range_m,
        beams=np.ascontiguousarray(beams, "<f8").tobytes(),
    )


# --- the table


def _percent(flags: Sequence[bool]) -> str:
    return f"{100.0 * np.mean(flags):6.1f}" if len(flags) else "     -"


HEADER = (
    f"{'':40}  called  lost  none   off  sure+wrong  sure at  score  steps off the map: "
    "called  lost at  beyond 5 sd of the reported error"
)


def line(result: Result) -> str:
    """One run."""
    rows = result.rows
    on = [row for row in rows if row.on_map]
    off = [row for row in rows if not row.on_map]
    wrong = [row.localized and not row.right for row in rows]
    sure = [
        i for i, row in enumerate(rows) if row.right and row.probability >= CONFIDENT_PROBABILITY
    ]
    if result.event_at is not None:
        sure = [i - result.event_at for i in sure if i >= result.event_at]
        noticed = [
            i - result.event_at
            for i, row in enumerate(rows)
            if i >= result.event_at and not row.localized
        ]
        extra = f"  noticed after {noticed[0] if noticed else '-'}"
    else:
        extra = ""
    score = np.mean([math.log(max(row.truth, 0.001)) for row in on]) if on else math.nan
    lost = [i for i, row in enumerate(rows) if row.state == "lost"]
    return (
        f"{result.group + ', ' + result.name:40} {_percent([r.localized for r in rows])} "
        f"{_percent([r.state == 'lost' for r in rows])} {np.mean([r.none for r in rows]):5.2f} "
        f"{np.mean([r.off_map for r in rows]):5.2f} {_percent(wrong):>10} "
        f"{sure[0] if sure else '-':>8} {score:7.2f} {'':18}{_percent([r.localized for r in off])}"
        f"  {lost[0] if lost and off else '-':>6}  {_reported_error([result])}{extra}"
        f"  {_cost([result])}"
    )


def summary(group: str, results: Sequence[Result]) -> str:
    """All runs of a group."""
    wrong = [np.mean([r.localized and not r.right for r in one.rows]) for one in results]
    called = [np.mean([r.localized for r in one.rows]) for one in results]
    off = [np.mean(f) for one in results if (f := [r.localized for r in one.rows if not r.on_map])]
    on = [math.log(max(r.truth, 0.001)) for one in results for r in one.rows if r.on_map]
    score = f"{np.mean(on):6.2f}" if on else "     -"
    return (
        f"{group:28} {len(results):3} runs  localized {100 * np.mean(called):5.1f} "
        f"({100 * min(called):.0f} to {100 * max(called):.0f})  sure and wrong "
        f"{100 * np.mean(wrong):5.1f} ({100 * max(wrong):.0f})  off the map, localized "
        + (f"{100 * np.mean(off):5.1f} ({100 * max(off):.0f})" if off else "    -")
        + f"  score {score}  {_reported_error(results)}  {_cost(results)}"
    )


def _reported_error(results: Sequence[Result]) -> str:
    """Return how many estimates of a right place are farther off than they say, and the RMSE."""
    right = [row for one in results for row in one.rows if row.right]
    if not right:
        return "-"
    rmse_m = math.sqrt(np.mean([row.error_m**2 for row in right]))
    return f"{sum(row.sds > MOST_SDS for row in right)} of {len(right)} ({rmse_m:.3f} m)"


def _cost(results: Sequence[Result]) -> str:
    """Return the CPU time of a step; its ratio to that of the baseline."""
    rows = [row for one in results for row in one.rows[WARM_UP_STEPS:]]
    text = f"{1000 * np.mean([row.cpu_s for row in rows]):.0f} ms a step"
    if baseline_s := math.fsum(one.baseline_cpu_s for one in results):
        text += f", {math.fsum(row.cpu_s for row in rows) / baseline_s:.2f} of the baseline"
    return text


def main(
    names: Annotated[list[str] | None, typer.Argument()] = None,
    cache: Annotated[Path | None, typer.Option()] = None,
    jobs: int = 2,
    baseline: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Compare CPU time with that of these settings."),
    ] = None,
) -> None:
    """Run and print."""
    named = os.environ.get(DATA_VARIABLE)
    chosen = [
        one
        for one in conditions(Path(named) if named else None)
        if not names or any(name in f"{one.group}, {one.name}" for name in names)
    ]
    results: list[Result] = []
    print(HEADER)
    with ProcessPoolExecutor(jobs) as pool:
        waiting = [
            pool.submit(run_numbered, named, i.group, i.name, baseline or ()) for i in chosen
        ]
        for future in waiting:
            result = future.result()
            print(line(result), flush=True)
            results.append(result)
            if cache is not None:
                cache.mkdir(parents=True, exist_ok=True)
                file = cache / f"{result.group}, {result.name}.msgpack"
                file.write_bytes(msgspec.msgpack.encode(result))
    groups = dict.fromkeys(result.group for result in results)
    for group in groups:
        print(summary(group, [result for result in results if result.group == group]))


def run_numbered(data: str | None, group: str, name: str, baseline: Sequence[str]) -> Result:
    """One condition, in a process of its own."""
    known = conditions(Path(data) if data else None)
    condition = next(one for one in known if (one.group, one.name) == (group, name))
    return run(condition, Settings(), load_settings(None, baseline) if baseline else None)


if __name__ == "__main__":
    typer.run(main)
