"""Is a robot found on the right floor, and is it ever sure of a wrong one?

    python -m benchmarks.floors DATA ROW... [--seeds N] [--steps N]

DATA is the folder of recordings and maps. The rows are

* `nine`: recordings, in a building whose floors are the maps of all of them; three starts each;
* `gdc`: a robot simulated on each of four floors of one building;
* `missing`: the same robots, in the building without their own floor;
* `rides`: rides in `sim:tower`, whose upper floors look alike but for one room, until `seeds` of
  them were between these floors; also from which step on a scan shows that room (10 beams differ);
* `cost`: CPU of a step and memory, against the same floors with hardly a gap between them.
"""

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.wean import WeanRobot
from clustermcl.evaluation.measures import pose_error
from clustermcl.evaluation.run import Case, RecordedRobot, Run, SimulatedRobot, course_of
from clustermcl.filter.laser.ray_casting import cast_rays_from_poses, jump_field
from clustermcl.filter.poses import compose
from clustermcl.jobs.scan_arrays import scan_of_laser
from clustermcl.recordings.maps import building as buildings
from clustermcl.runtime.settings import Settings

RECORDED = ("aces", "belgioioso", "edmonton", "fhw", "fr079", "fr101", "intel", "crob-jarvis")
GDC = {"1": "f1", "2": "f2_2019", "3": "f3", "4": "f4"}
ALIKE = {"first", "second"}
AFTER_STEPS, MOST_STEPS = 40, 30_000
TOLD_M, TOLD_BEAMS = 0.3, 10


def write_building(folder: Path, maps: dict[str, Path]) -> Path:
    path = folder / "building.yaml"
    lines = (f"  {name}: {file.resolve()}\n" for name, file in maps.items())
    path.write_text("floors:\n" + "".join(lines))
    return path


def run_of(robot: RecordedRobot | SimulatedRobot, seed: int, steps: int, start: int = 0) -> Run:
    case = Case(robot=robot, updates=steps)
    return Run(case=case, seed=seed, settings=Settings(), start_step=start)


def judge(what: str, run: Run, floor: str) -> None:
    """Print the first step that is sure and right, and the numbers of sure and of wrong steps."""
    course, steps = run.begun()
    begin_s, found, wrong, sure = time.process_time(), -1, 0, 0
    for number, (_, outcome, truth) in enumerate(steps):
        if outcome.state != "localized" or truth is None:
            continue
        best = outcome.hypotheses[0].pose
        right = course.map.floors.on_floor(best)[0] == floor and pose_error(best, truth).right
        sure, wrong = sure + 1, wrong + (not right)
        found = number if right and found < 0 else found
    cpu_s = time.process_time() - begin_s
    print(f"{what}: right at {found}, sure {sure}, wrong {wrong}, {cpu_s:.1f} s", flush=True)


def nine(data: Path, folder: Path, _seeds: int, steps: int) -> None:
    names = (*RECORDED, "wean")
    file = write_building(folder, {name: data / name / "map.yaml" for name in names})
    for name in names:
        kind, log, reference = RecordedRobot, "log.clf.gz", "groundtruth.tum"
        if name == "wean":
            kind, log, reference = WeanRobot, "robotdata1.log.xz", "robotdata1.reference.tum"
        here = data / name
        robot = kind(recording=here / log, map=file, reference=here / reference, floor=name)
        count = sum(1 for _ in course_of(Case(robot=robot), 0, Settings().bridge).steps)
        for start in (0, max(count - steps, 0) // 2, max(count - steps, 0)):
            judge(f"{name} from {start}", run_of(robot, 0, steps, start), name)


def gdc(data: Path, folder: Path, seeds: int, steps: int, *, missing: bool = False) -> None:
    maps = {name: data / "gdc" / f"{file}.yaml" for name, file in GDC.items()}
    for own, file in maps.items():
        kept = {name: path for name, path in maps.items() if not (missing and name == own)}
        floor = next(iter(kept)) if missing else own
        robot = SimulatedRobot(world=str(file), map=write_building(folder, kept), floor=floor)
        for seed in range(seeds):
            what = f"{'without ' if missing else ''}{own} seed {seed}"
            judge(what, run_of(robot, seed, steps), "" if missing else own)


def without_own_floor(data: Path, folder: Path, seeds: int, steps: int) -> None:
    gdc(data, folder, seeds, steps, missing=True)


def rides(_data: Path, _folder: Path, seeds: int, _steps: int) -> None:
    course, made = run_of(SimulatedRobot(world="tower"), 0, MOST_STEPS).begun()
    floors, lift = course.map.floors, course.simulation and course.simulation.lift
    jumps = jump_field(course.map.cells)
    assert lift is not None
    begun, last, before, since, found, wrong, lost, count = 0, "", "", 0, -1, 0, 0, 0
    told = -1
    for scan, outcome, truth in made:
        lost += outcome.state == "lost"
        if lift.rides > begun:
            begun, before, since, found, wrong, told = lift.rides, last, 0, -1, 0, -1
        if lift.middle is not None or truth is None:
            continue
        (last, there), since = floors.on_floor(truth), since + 1
        if outcome.state == "localized":
            right = floors.on_floor(outcome.hypotheses[0].pose)[0] == last
            wrong, found = wrong + (not right), since if right and found < 0 else found
        if told < 0 and begun:
            laser = scan_of_laser(scan)
            poses = compose(
                np.array([truth, *(floors.in_atlas(name, there) for name in floors.names)]),
                laser.robot_from_laser,
            )
            ends = cast_rays_from_poses(
                jumps, course.map.grid, poses, laser.angles, scan.range_max_m
            )
            differ = np.count_nonzero(np.abs(ends[1:] - ends[0]) > TOLD_M, axis=1)
            told = since if np.count_nonzero(differ < TOLD_BEAMS) == 1 else told  # only its own
        if begun and since == AFTER_STEPS:
            alike = {before, last} == ALIKE
            count += alike
            ride = f"{before} to {last}{' (alike)' if alike else ''}: told apart at {told}"
            said = f"sure of a wrong one {wrong}, lost so far {lost}"
            print(f"{ride}, right floor after {found} steps, {said}", flush=True)
        if count == seeds:
            return


def cost(data: Path, folder: Path, seeds: int, steps: int) -> None:
    maps = {name: data / "gdc" / f"{file}.yaml" for name, file in GDC.items()}
    robot = SimulatedRobot(world=str(maps["3"]), map=write_building(folder, maps), floor="3")
    for gap_m in (0.5, buildings.GAP_M):
        buildings.GAP_M, ms = gap_m, []  # type: ignore[misc] # to compare
        for seed in range(seeds):
            _, made = run_of(robot, seed, steps).begun()
            begin_s, count = time.process_time(), sum(1 for _ in made)
            ms.append(1e3 * (time.process_time() - begin_s) / count)
        most_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"gap {gap_m} m: {np.median(ms):.1f} ms a step, up to {most_mb:.0f} MB", flush=True)


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
