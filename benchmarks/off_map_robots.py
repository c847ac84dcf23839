"""Robots that are nowhere on their map, and as controls the same ones in their own maps.

Mirror images of recordings, recordings in foreign maps, robots in parts of a building that were not
mapped, lifted ones; robots among people, with short-sighted lasers and in maps with holes.
"""

import math
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.experiments.case import Case, RecordedRobot
from benchmarks.experiments.catalogue import recorded_cases
from benchmarks.people import CrowdSimulation
from benchmarks.worlds import world
from clustermcl.evaluation.run import TrueStep, course_of
from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN
from clustermcl.filter.kernels.compiled import to_cells
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan, mirrored
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.runtime.settings import BridgeSettings
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
        first = round(from_share * max(count - STEPS_OF_A_START, 0))
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
