"""What `clustermcl changes` finds of what has changed, and how well robots localize in the new map.

python -m benchmarks.changes DATA [NAME ...]

DATA/aged are recordings in maps that have aged; the building is known: that of intel is
DATA/intel, that of the hall is what most of its aged maps agree on, and unknown where it was
refurnished. A changed cell counts as seen
if beams at the true poses, while the robot was localized, ended in it (new) or passed it (gone)
from three places 0.5 m apart. A cell is found, or false, within one cell (0.1 m).

Constants were chosen on move20, del20 and shift20; the others report.
"""

import sys
import tempfile
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from benchmarks.aged_maps import Mask
from clustermcl.belief.outcome import Outcome
from clustermcl.changes.collector import REACH_M, ChangeCollector
from clustermcl.changes.new_map import with_changes
from clustermcl.commands.changes import changes_of_recording
from clustermcl.evaluation.run import Case, EstimatedStep, RecordedRobot, Run, SimulatedRobot
from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN, Cells
from clustermcl.filter.poses import between, compose
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan
from clustermcl.recordings.maps.grid_map import GridMap, coarse
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.recordings.maps.ros_map import save_ros_map
from clustermcl.runtime.settings import Settings

Robot = RecordedRobot | SimulatedRobot
PEOPLE, STEPS, SEEDS = 0.15, 160, (1, 2, 3)
LEARNED_IN = (160, 300, 500)
PLACES, PLACE_M = 3, 0.5
_RIGHT_M = 1.0


def main(data: Path, names: Sequence[str]) -> None:
    """Run some of the parts: names of recordings in DATA/aged, `fr079` and `gdc`."""
    aged = sorted(each.stem for each in (data / "aged").glob("*.yaml"))
    for name in names or (*aged, "fr079", "gdc"):
        match name:
            case "fr079":
                part1, part2 = (
                    recording(data / "split" / name / f"part{n}", "map") for n in (1, 2)
                )
                compare(name, part2, learned(part1), load_map(data / name / "map.yaml"))
            case "gdc":
                drives_of_gdc(data / name)
            case _:
                recorded, true = recording(data / "aged" / name), true_building(data, name)
                compare(name, recorded, learned(recorded), true)
                if true is not None:
                    print_found(name, recorded, true)


def learned(robot: RecordedRobot) -> list[GridMap]:
    """Return the new map that the command makes of a recording, with each seed."""
    old, of = load_map(robot.map), robot.recording
    made = (changes_of_recording(of, old, replace(Settings(), seed=seed)) for seed in SEEDS)
    return [with_changes(old, changes) for changes in made]


def print_found(name: str, robot: RecordedRobot, true: GridMap) -> None:
    steps = list(run(robot))
    for people in (0.0, PEOPLE):
        said = found(collected(load_map(robot.map), steps, people), true, steps)
        print(f"{name}, people {people:.0%}: {said}", flush=True)


def drives_of_gdc(folder: Path) -> None:
    """Drive in the building of 2019 with the map of 2016, and with maps learned in some steps.

    A new map lacks what the learning robot has not seen. So the third map compared here is the
    true one where that robot's beams have been, and that of 2016 elsewhere.
    """
    file, world = (folder / f"f2_{year}.yaml" for year in (2016, 2019))
    robot, old, true = SimulatedRobot(world=str(world), map=file), load_map(file), load_map(world)
    steps = list(run(robot, seed=7, count=max(LEARNED_IN)))
    compare("gdc", robot, [], true)
    for count in LEARNED_IN:
        collector = collected(old, steps[:count])
        new = with_changes(old, collector.changes("benchmark"))
        seen = wide(collector.seen_min > 0)
        rows, cols = (np.arange(n) * old.cell_m // collector.cell_m for n in old.cells.shape)
        fine = seen[np.ix_(rows.astype(int), cols.astype(int))]
        known = GridMap(np.where(fine, true.cells, old.cells), old.cell_m, old.map_from_grid)
        compare(f"gdc, learned in {count} steps, new and known", robot, len(SEEDS) * [new], known)


def recording(stem: Path, map_name: str = "") -> RecordedRobot:
    grid_map = stem.with_name(f"{map_name}.yaml") if map_name else stem.with_suffix(".yaml")
    log = stem.with_name(f"{stem.name}.log.gz")
    return RecordedRobot(recording=log, map=grid_map, reference=stem.with_suffix(".tum"))


def run(robot: Robot, seed: int = 1, count: int = STEPS) -> Iterator[EstimatedStep]:
    case = Case(robot=robot, updates=count)
    return Run(case=case, seed=seed, settings=Settings()).begun()[1]


def collected(
    grid_map: GridMap, steps: Sequence[EstimatedStep], people: float = 0.0
) -> ChangeCollector:
    collector, rng = ChangeCollector(grid_map), np.random.default_rng(1)
    for scan, outcome, _ in steps:
        seen = with_people(scan, people, rng)
        collector.on_step(seen, outcome.state, outcome.hypotheses)
    return collector


def with_people(scan: Scan, share: float, rng: np.random.Generator) -> Scan:
    """Return a scan of which a share of the beams ends anywhere on its way."""
    ranges = scan.ranges.array().copy()
    short = rng.random(len(ranges)) < share
    ranges[short] *= rng.random(np.count_nonzero(short))
    return replace(scan, ranges=ArrayBlob.of(ranges, "float32"))


@cache
def true_building(data: Path, name: str) -> GridMap | None:
    if "intel" in name:
        return load_map(data / "intel" / "map.yaml")
    if "refurnish" in name:
        return None
    aged = [load_map(data / "aged" / f"{n}-hall-0.yaml") for n in
            ("move10", "move20", "del20", "shift20")]  # fmt: skip
    walls = np.sum([each.cells == OCCUPIED for each in aged], axis=0)
    free = np.sum([each.cells == FREE for each in aged], axis=0)
    cells = np.select([walls >= 3, free >= 2, walls >= 2], [OCCUPIED, FREE, OCCUPIED], UNKNOWN)
    return GridMap(cells.astype(np.int8), aged[0].cell_m, aged[0].map_from_grid)


def found(collector: ChangeCollector, true: GridMap, steps: Sequence[EstimatedStep]) -> str:
    """Return the shares of the changed cells that were found, and of seen cells that are false."""
    grid_map, cell_m = collector.map, collector.cell_m
    every = round(cell_m / grid_map.cell_m)
    old, new = (coarse(each.cells, every) for each in (grid_map, true))
    records, said = collector.records, np.zeros(old.shape, bool)
    now = records["occupied"] != (old.flat[records["cell"]] == OCCUPIED)
    said.flat[records["cell"][now]] = True
    places = from_places(steps, grid_map, cell_m, old)
    wall, built = old == OCCUPIED, new == OCCUPIED
    parts = []
    for kind, there, all_of, seen in (
        ("gone", said & wall, wall & ~built, wall & (new == FREE) & ~wide(built)),
        ("new", said & ~wall, built & ~wall, built & (old == FREE) & ~wide(wall)),
    ):
        known = seen & (places[int(kind == "new")] >= PLACES)
        hit, false = np.count_nonzero(known & wide(there)), np.count_nonzero(there & ~wide(all_of))
        parts.append(f"{kind} {hit} of {np.count_nonzero(known)} found, {false} false")
    return f"{'; '.join(parts)}; of {np.count_nonzero(places.max(axis=0))} cells seen"


def wide(mask: Mask) -> Mask:
    return np.asarray(binary_dilation(mask, np.ones((3, 3))))


def from_places(
    steps: Sequence[EstimatedStep], grid_map: GridMap, cell_m: float, cells: Cells
) -> NDArray[np.int64]:
    """Return (2, rows, cols) from how many places beams passed each cell, and ended in it."""
    counts = np.zeros((2, *cells.shape), np.int64)
    known: tuple[dict[int, list[NDArray[np.float64]]], ...] = ({}, {})
    for scan, outcome, truth in steps:
        if truth is None or not is_sure_and_right(outcome, truth):
            continue
        laser = compose(np.array(truth), np.array(scan.robot_from_laser))
        ranges = scan.ranges.array()
        at = np.flatnonzero((ranges > 0.0) & (ranges < scan.range_max_m))
        angles = scan.angle_min_rad + scan.angle_step_rad * at
        ends = (np.cos(angles), np.sin(angles)) * ranges[at]
        way = compose(laser, np.column_stack([*ends, angles]))[:, :2] - laser[:2]
        length = np.hypot(*way.T)
        along = np.arange(0.05, REACH_M, 0.05)
        beam, at = np.nonzero(along < np.minimum(length - 0.3, REACH_M)[:, None])
        passed = way[beam] / length[beam, None] * along[at][:, None]
        for kind, ends in enumerate((passed, way[length <= REACH_M])):
            points = np.column_stack([laser[:2] + ends, np.zeros(len(ends))])
            in_grid = between(np.array(grid_map.map_from_grid), points)[:, :2]
            cols, rows = np.floor(in_grid / cell_m).astype(int).T
            inside = (rows >= 0) & (cols >= 0) & (rows < cells.shape[0]) & (cols < cells.shape[1])
            for cell in np.unique(rows[inside] * cells.shape[1] + cols[inside]).tolist():
                seen_from = known[kind].setdefault(cell, [])
                apart = [np.hypot(*(laser[:2] - one)) >= PLACE_M for one in seen_from]
                if len(seen_from) < PLACES and all(apart):
                    seen_from.append(laser[:2])
                    counts[kind].flat[cell] += 1
    return counts


def is_sure_and_right(outcome: Outcome, truth: PoseTuple) -> bool:
    if outcome.state != "localized":
        return False
    best = outcome.hypotheses[0].pose
    return float(np.hypot(best[0] - truth[0], best[1] - truth[1])) < _RIGHT_M


def compare(name: str, robot: Robot, new: Sequence[GridMap], true: GridMap | None) -> None:
    """Print on which share of the steps the robot is sure and right in the old, new, true map."""
    said = []
    for maps in (len(SEEDS) * [load_map(Path(robot.map or ""))], new, len(SEEDS) * [true]):
        shares = [sure_and_right(robot, m, s) for s, m in enumerate(maps, 1) if m is not None]
        said.append(" ".join(f"{share:.0%}" for share in shares) or "unknown")
    print(f"{name}: sure and right in the old, new, true map: {'; '.join(said)}", flush=True)


def sure_and_right(robot: Robot, grid_map: GridMap, seed: int) -> float:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "map.yaml")
        save_ros_map(grid_map, file)
        steps = list(run(replace(robot, map=file), seed))
    return float(np.mean([is_sure_and_right(o, t) for _, o, t in steps if t is not None]))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
