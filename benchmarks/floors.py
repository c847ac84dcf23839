"""Is a robot found on the right floor, and is it ever sure of a wrong one?

    python -m benchmarks.floors DATA ROW... [--seeds N] [--steps N]

DATA is the folder of recordings and maps. The rows are

* `nine`: recordings, in a building whose floors are the maps of all of them; three starts each;
* `gdc`: a robot simulated on each of four floors of one building;
* `missing`: the same robots, in the building without their own floor;
* `rides`: rides between floors 3 and 4 of that building, which look alike, at places that are free
  on both; `seeds` places, two rides at each;
* `cost`: CPU of a step and memory, against the same floors without the gaps between them.
"""

import argparse
import resource
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path

import msgspec
import numpy as np
from scipy.ndimage import distance_transform_edt

from benchmarks.wean import WeanRobot
from clustermcl.evaluation.course import Case, RecordedRobot, SimulatedRobot, course_of
from clustermcl.evaluation.pose_error import pose_error
from clustermcl.evaluation.run import EstimatedStep, Run
from clustermcl.filter.arrays import FREE
from clustermcl.jobs.in_process import InProcess
from clustermcl.jobs.map_model import sensor_model
from clustermcl.protocol.floors import Floors, Link
from clustermcl.recordings.maps import building as buildings
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.runtime.folders import kept_folder
from clustermcl.runtime.settings import Settings
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.source import SimulatedSource, simulated_steps
from clustermcl.simulator.worlds.world import world_from_map

RECORDED = ("aces", "belgioioso", "edmonton", "fhw", "fr079", "fr101", "intel", "crob-jarvis")
GDC = {"1": "f1", "2": "f2_2019", "3": "f3", "4": "f4"}
ROOM_M, AFTER_STEPS = 1.2, 40


def write_building(folder: Path, maps: dict[str, Path]) -> Path:
    path = folder / "building.yaml"
    lines = (f"  {name}: {file.resolve()}\n" for name, file in maps.items())
    path.write_text("floors:\n" + "".join(lines))
    return path


def judged(
    steps: Iterable[EstimatedStep], floors: Floors, floor: str
) -> Iterator[tuple[bool, ...]]:
    """Yield for each step whether it is sure, of the right floor, and of the right place."""
    for _, outcome, truth in steps:
        best = outcome.hypotheses[0] if outcome.hypotheses else None
        sure = outcome.state == "localized" and best is not None
        on_floor = best is not None and floors.on_floor(best.pose)[0] == floor
        error = pose_error(best.pose, truth) if best and truth else None
        yield sure, on_floor, error is not None and error.right


def run_of(robot: RecordedRobot | SimulatedRobot, seed: int, steps: int, start: int = 0) -> Run:
    case = Case(robot=robot, updates=steps)
    return Run(case=case, seed=seed, settings=Settings(), start_step=start)


def first_right(run: Run, floor: str) -> tuple[int | None, int, int, float]:
    """Return the first step that is sure and right, sure wrong steps, sure steps, and CPU [s]."""
    course, steps = run.begun()
    begin_s, found, wrong, sure = time.process_time(), None, 0, 0
    for number, (is_sure, on_floor, right) in enumerate(judged(steps, course.map.floors, floor)):
        sure += is_sure
        wrong += is_sure and not (on_floor and right)
        if found is None and is_sure and on_floor and right:
            found = number
    return found, wrong, sure, time.process_time() - begin_s


def nine(data: Path, folder: Path, _seeds: int, steps: int) -> None:
    names = (*RECORDED, "wean")
    file = write_building(folder, {name: data / name / "map.yaml" for name in names})
    for name in names:
        if name == "wean":
            log, reference = (
                data / name / f"robotdata1.{end}" for end in ("log.xz", "reference.tum")
            )
            robot: RecordedRobot = WeanRobot(
                recording=log, map=file, reference=reference, floor=name
            )
        else:
            log, reference = data / name / "log.clf.gz", data / name / "groundtruth.tum"
            robot = RecordedRobot(recording=log, map=file, reference=reference, floor=name)
        count = sum(1 for _ in course_of(Case(robot=robot), 0, Settings().bridge).steps)
        for start in (0, max(count - steps, 0) // 2, max(count - steps, 0)):
            report(f"{name} from {start}", steps, first_right(run_of(robot, 0, steps, start), name))


def gdc(data: Path, folder: Path, seeds: int, steps: int, *, missing: bool = False) -> None:
    maps = {name: data / "gdc" / f"{file}.yaml" for name, file in GDC.items()}
    for own, file in maps.items():
        kept = {name: path for name, path in maps.items() if not (missing and name == own)}
        building = write_building(folder, kept)
        floor = next(iter(kept)) if missing else own
        robot = SimulatedRobot(world=str(file), map=building, floor=floor)
        for seed in range(seeds):
            found = first_right(run_of(robot, seed, steps), "" if missing else own)
            report(f"{'without ' if missing else ''}{own} seed {seed}", steps, found)


def without_own_floor(data: Path, folder: Path, seeds: int, steps: int) -> None:
    gdc(data, folder, seeds, steps, missing=True)


def cost(data: Path, folder: Path, seeds: int, steps: int) -> None:
    maps = {name: data / "gdc" / f"{file}.yaml" for name, file in GDC.items()}
    robot = SimulatedRobot(world=str(maps["3"]), map=write_building(folder, maps), floor="3")
    gap_m = buildings.GAP_M
    for gap in (0.5, gap_m):
        buildings.GAP_M = gap  # type: ignore[misc] # to compare
        begin_s, seconds = time.process_time(), []
        for seed in range(seeds):
            _, made = run_of(robot, seed, steps).begun()
            first = time.process_time()
            list(islice(made, steps))
            seconds.append((time.process_time() - first) / steps)
        most_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        whole_s = time.process_time() - begin_s
        ms = 1e3 * float(np.median(seconds))
        print(f"gap {gap} m: {ms:.1f} ms a step, {whole_s:.0f} s, up to {most_mb:.0f} MB")


def rides(data: Path, _folder: Path, seeds: int, _steps: int) -> None:
    maps = {name: load_map(data / "gdc" / f"{GDC[name]}.yaml") for name in ("3", "4")}
    shared = np.logical_and(
        *(each.cells == FREE for each in maps.values())
    )  # they lie one on another
    room = distance_transform_edt(shared) * maps["3"].cell_m
    x0, y0, _ = maps["3"].map_from_grid
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 60])
        row, col = rng.choice(np.argwhere(room > ROOM_M))
        at = (float(x0 + col * maps["3"].cell_m), float(y0 + row * maps["3"].cell_m))
        link = Link("lift", {"3": at, "4": at}, 1.3)
        atlas = buildings.atlas_of(maps, {"3": 0.0, "4": 4.0}, (link,))
        start = atlas.floors.in_atlas("3", (*at, float(rng.uniform(-np.pi, np.pi))))
        ride(Simulation(world_from_map(atlas, start), seed), seed)


def ride(simulation: Simulation, seed: int) -> None:
    """Report two rides of a robot: steps from the doors' opening until sure, and wrong ones."""
    settings, grid_map = msgspec.structs.replace(Settings(), seed=seed), simulation.world.map
    floors, lift = grid_map.floors, simulation.lift
    assert lift is not None
    source = SimulatedSource(simulation, steps=600)
    scans = simulated_steps(source, settings.bridge, grid_map.digest, floors)
    process = InProcess(sensor_model(grid_map, settings.sensor, kept_folder("maps")), settings)
    since, found, wrong, begun, lost = 0, -1, 0, 0, 0
    for scan, truth in scans:
        outcome, floor = process.advance(scan), floors.on_floor(truth)[0]
        begun = lift.rides
        lost += outcome.state == "lost" and begun > 0
        if lift.middle is not None:
            since, found = 0, -1
            continue
        since += begun > 0
        if begun and outcome.state == "localized":
            is_right = floors.on_floor(outcome.hypotheses[0].pose)[0] == floor
            wrong += not is_right
            found = since if is_right and found < 0 else found
        if begun and since == AFTER_STEPS:
            print(f"ride {begun} of seed {seed}: right floor {found} steps after the doors opened, "
                  f"sure of the wrong floor {wrong}, lost {lost}", flush=True)  # fmt: skip
            wrong = lost = 0
            if begun == 2:
                return


def report(what: str, steps: int, found: tuple[int | None, int, int, float]) -> None:
    first, wrong, sure, cpu_s = found
    print(
        f"{what}: right at {first}, sure {sure}, wrong {wrong} of {steps}, {cpu_s:.1f} s",
        flush=True,
    )


ROWS: dict[str, Callable[[Path, Path, int, int], None]] = {
    "nine": nine, "gdc": gdc, "missing": without_own_floor, "rides": rides, "cost": cost,
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("data", type=Path)
    parser.add_argument("rows", nargs="+", choices=ROWS)
    parser.add_argument("--seeds", type=int, default=24)
    parser.add_argument("--steps", type=int, default=60)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for row in options.rows:
            ROWS[row](options.data, Path(folder), options.seeds, options.steps)


if __name__ == "__main__":
    main()
