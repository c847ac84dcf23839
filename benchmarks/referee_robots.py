"""The robots of `benchmarks.referee`, each with a map that may have aged or be another's."""

import hashlib
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from benchmarks import aged_maps, off_map_robots, worlds
from benchmarks.aged_maps import Pieces
from benchmarks.experiments.case import RecordedRobot
from benchmarks.experiments.catalogue import recorded_cases
from benchmarks.people import CrowdSimulation
from clustermcl.evaluation import run as runs
from clustermcl.evaluation.run import course_of
from clustermcl.filter.poses import between, compose
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.pose_arrays import pose_tuple
from clustermcl.protocol.steps import Scan, mirrored
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.simulator.simulation import simulated_steps

STEPS, CHANGED_AT = 100, 60
WHOLE = 1_000_000
"""Steps of a recording, at most."""
KIDNAPPED_AT = 40
SPINNING_SHARE, SPUN_M = 0.04, 0.4
"""Share of the steps in which wheels spin, and the distance that odometry reports too much [m]."""
SHARE_OF_FURNITURE = 0.06

Role = Literal["training", "validation", "test"]
ROLES: dict[str, Role] = {
    "hall": "training", "intel": "training", "fr101": "training", "office": "validation",
    "wean-1": "training", "wean-2": "training", "wean-3": "training", "cross_feature": "validation",
}  # fmt: skip
"""Buildings on which constants are chosen; all others are for test."""
TrueSteps = list[tuple[Scan, PoseTuple | None]]
Begin = Literal["given", "nothing", "wrong"]


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One robot with one map."""

    row: str
    robot: str
    """A world, a recording, `split/NAME/PART`, `aged/NAME`, a map file, or one of these and the map
    to localize in."""
    number: int = 0
    """Seed of a simulated robot; of a recorded one where in the recording it begins, in tenths."""
    begin: Begin = "given"
    """Whether the pose is given after the first scan, or a wrong one, or none."""
    steps: int = STEPS
    change: str = ""
    """A key of `CHANGES`."""
    people: int = 0
    """Number of people who walk near a simulated robot."""
    on_map: bool = True
    scored_from: int = 1
    draw: str = ""
    """Other changes of the map, and another given pose, for each name."""

    @property
    def name(self) -> str:
        return f"{self.row}, {self.robot} {self.number}"

    @property
    def role(self) -> Role:
        return ROLES.get(self.robot, "test")

    @property
    def rng(self) -> np.random.Generator:
        """Random numbers that depend on the robot and the change, not on the filter."""
        named = f"{self.draw} {self.robot} {self.number} {self.change}".lstrip()
        digest = hashlib.sha256(named.encode()).digest()
        return np.random.default_rng(np.frombuffer(digest, np.uint32))


CHANGES: dict[str, Callable[[GridMap, np.random.Generator], GridMap]] = {
    **{
        f"moved {share} %": lambda m, rng, share=share: aged_maps.with_pieces(
            m, Pieces(share=share / 100), rng
        )
        for share in (5, 10, 20, 40)
    },
    "missing": lambda m, rng: aged_maps.with_pieces(m, Pieces(share=0.2, painted=False), rng),
    "aside": lambda m, rng: aged_maps.with_pieces(
        m, Pieces(share=0.2, side_m=(1.5, 3.0), aside_m=(0.5, 0.5)), rng
    ),
    "gone": lambda m, rng: aged_maps.with_pieces(m, Pieces(share=0.2, removed=False), rng),
    "doors": lambda m, rng: aged_maps.with_closed_passages(m, (0.6, 1.3), 8, rng),
    "walls": lambda m, rng: aged_maps.with_closed_passages(m, (1.3, 4.0), 6, rng),
}
"""What the map has that the building has not, and the other way round."""
_FURNISHED = ("refurnished", "late refurnished")
_AGED = (("hall", 1), ("hall", 2), ("office", 1), ("office", 2), ("intel", 1), ("intel", 6),
         ("fr101", 0), ("aces", 1), ("aces", 5), ("fr079", 2), ("edmonton", 3),
         ("belgioioso", 4))  # fmt: skip
_AGED_SMALL = (("hall", 1), ("office", 2), ("intel", 1), ("aces", 5))
_CLEAR = ("aces", "belgioioso", "edmonton", "fhw", "fr079", "fr101", "intel")
_PLAIN = (*_CLEAR, "crob-jarvis", "wean-1", "wean-2", "wean-3")
_BEGINS: tuple[tuple[str, Begin], ...] = (("given", "given"), ("from nothing", "nothing"))
_LOGS = ("move10-hall-0", "move10-intel-0", "del20-hall-0", "del20-intel-0", "shift20-hall-0",
         "shift20-intel-0", "refurnish-hall-0", "refurnish-intel-0", "move20-hall-0",
         "move20-intel-0", "late-refurnish-hall-1")  # fmt: skip
_MAPS = ("carmen-maps/freiburg", "carmen-maps/longwood", "carmen-maps/nsh_level_3",
         "carmen-maps/thickwean", "carmen-maps/wean5300", "gdc/f2_2019", "gdc/f4", "ros-maps/depot",
         "ros-maps/turtlebot3_world", "ros-maps/warehouse")  # fmt: skip
_OF_MAPS = ("carmen-maps/", "gdc/", "ros-maps/")
_SPLIT = (("fhw", 4), ("fr079", 3), ("intel", 2))


def battery(*, small: bool) -> Iterator[Trial]:
    """Yield all trials."""
    yield from _in_aged_maps(small=small)
    yield from _in_other_maps(small=small)
    yield from _off_map(small=small)


def _in_aged_maps(*, small: bool) -> Iterator[Trial]:
    aged = _AGED_SMALL if small else _AGED
    for change in ("", *CHANGES, "refurnished"):
        for robot, number in aged:
            name = change or "true map"
            yield Trial(row=f"given, {name}", robot=robot, number=number, change=change)
    for change in ("", "moved 20 %", "refurnished"):
        for robot, number in aged:
            row = f"from nothing, {change or 'true map'}"
            yield Trial(row=row, robot=robot, number=number, change=change, begin="nothing")
    for robot, number in aged:
        yield Trial(
            row="late refurnished", robot=robot, number=number, change="late refurnished",
            steps=CHANGED_AT + STEPS, scored_from=CHANGED_AT,
        )  # fmt: skip
    for robot, number in aged:
        yield Trial(row="given wrongly", robot=robot, number=number, begin="wrong")


def _in_other_maps(*, small: bool) -> Iterator[Trial]:
    seeds = (1,) if small else (1, 2, 3, 4)
    for world, number in itertools.product(("hall", "office"), seeds):
        yield Trial(row="kidnapped", robot=world, number=number, change="kidnapped")
    for world, number in itertools.product(("hall", "office"), seeds):
        yield Trial(
            row="given, moved 20 %, people", robot=world, number=number, change="moved 20 %",
            people=20,
        )  # fmt: skip
    for robot, number in _AGED_SMALL if small else _AGED:
        yield Trial(row="given, spinning wheels", robot=robot, number=number, change="spinning")
    for world in ("hall_symmetric", "cross"):
        yield Trial(row="symmetric", robot=world, number=1, begin="nothing")
    for (row, begin), number in itertools.product(_BEGINS, seeds):
        yield Trial(
            row=f"one cabinet, {row}", robot="cross_feature", number=number, begin=begin, steps=200
        )
    years = "gdc/f2_2019 in gdc/f2_2016"
    for (row, begin), number in itertools.product(_BEGINS, seeds):
        yield Trial(row=f"gdc, years, {row}", robot=years, number=number, begin=begin)
    for (row, begin), (name, parts) in itertools.product(_BEGINS, _SPLIT):
        for part in (parts - 1,) if small else range(parts):
            yield Trial(row=f"split, {row}", robot=f"split/{name}/part{part}", begin=begin)
    for (row, begin), name in itertools.product(_BEGINS, _LOGS[6:8] if small else _LOGS):
        yield Trial(row=f"aged logs, {row}", robot=f"aged/{name}", begin=begin, steps=160)
    for change in ("", "moved 20 %", "moved 40 %", "refurnished"):
        for name in _PLAIN[:2] if small else _PLAIN:
            row = f"given, whole recordings, {change or 'true map'}"
            yield Trial(row=row, robot=name, steps=WHOLE, change=change)


def in_maps(*, small: bool) -> Iterator[Trial]:
    """Yield robots in buildings of which there is only a map.

    No constant was chosen on these maps; but two are of floors of Wean Hall, and two of gdc, whose
    recordings and other floors checked some.
    """
    of_begin = {
        "given": ("", "moved 20 %", "moved 40 %", "refurnished", "missing", "aside"),
        "nothing": ("", "moved 20 %", "refurnished"),
    }
    for row, begin in _BEGINS:
        for change, name in itertools.product(of_begin[begin], _MAPS[-3:] if small else _MAPS):
            for number in (1,) if small else (1, 2):
                yield Trial(
                    row=f"maps, {row}, {change or 'true map'}", robot=name, number=number,
                    begin=begin, change=change,
                )  # fmt: skip


def _off_map(*, small: bool) -> Iterator[Trial]:
    """Yield robots that are nowhere on their maps."""
    for (row, begin), number in itertools.product(_BEGINS, (1,) if small else (1, 2, 3, 4)):
        floors, name = "gdc/f3 in gdc/f4", f"gdc, floors, {row}"
        yield Trial(row=name, robot=floors, number=number, begin=begin, on_map=False)
    for name in _CLEAR[:2] if small else _CLEAR:
        for number in (0,) if small else (0, 3, 6):
            yield Trial(
                row="mirrored", robot=name, number=number, begin="nothing", change="mirrored",
                on_map=False,
            )  # fmt: skip
    for robot, place in off_map_robots.FOREIGN[:2] if small else off_map_robots.FOREIGN:
        yield Trial(row="foreign", robot=f"{robot} in {place}", begin="nothing", on_map=False)
    for world, number in (("hall", 1),) if small else itertools.product(("hall", "office"), (1, 2)):
        yield Trial(
            row="half", robot=world, number=number, begin="nothing", change="half", on_map=False
        )


def begun(trial: Trial, data: Path | None) -> tuple[GridMap, TrueSteps]:
    """Return the map that the localizer gets, and the steps."""
    grid_map, steps = _robot(trial, data)
    change, rng = trial.change, trial.rng
    if change in CHANGES:
        grid_map = CHANGES[change](grid_map, rng)
    elif change in _FURNISHED:
        path = [truth for _, truth in steps if truth is not None]
        old, new = (aged_maps.furniture(grid_map, SHARE_OF_FURNITURE, path, rng) for _ in range(2))
        late = CHANGED_AT if change != "refurnished" else 0
        first = aged_maps.seen_with_furniture(steps[:late], grid_map, old, rng)
        steps = [*first, *aged_maps.seen_with_furniture(steps[late:], grid_map, new, rng)]
        grid_map = aged_maps.with_furniture(grid_map, old)
    elif change == "mirrored":
        steps = [(mirrored(scan), None) for scan, _ in steps]
    elif change == "spinning":
        steps = with_spinning_wheels(steps, rng)
    return grid_map, steps


def _robot(trial: Trial, data: Path | None) -> tuple[GridMap, TrueSteps]:
    """Return the robot's own map, or the one it is localized in, and the steps."""
    robot, _, place = trial.robot.partition(" in ")
    if robot.startswith(_OF_MAPS):
        assert data is not None
        driven, given = (data / f"{name}.yaml" for name in (robot, place or robot))
        simulated = runs.SimulatedRobot(world=str(driven), map=given)
        case = runs.Case(robot=simulated, updates=trial.steps)
        made = course_of(case, trial.number, BridgeSettings())
        return made.map, list(made.steps)
    if robot.startswith(("split/", "aged/")):
        assert data is not None
        part = data / robot
        recorded = RecordedRobot(
            recording=part.with_name(f"{part.name}.log.gz"),
            map=part.with_name("map.yaml") if "split/" in robot else part.with_suffix(".yaml"),
            reference=part.with_suffix(".tum"),
        )
        return recorded_steps(runs.Case(robot=recorded), 0.0, trial.steps)
    cases = {case.name: case for case in recorded_cases(data)}
    if robot in cases:
        grid_map, steps = recorded_steps(cases[robot], trial.number / 10, trial.steps)
        if place:
            assert isinstance(cases[place].robot, RecordedRobot)
            return load_map(cases[place].robot.map), [(scan, None) for scan, _ in steps]
        return grid_map, steps
    world = worlds.world(robot)
    start = (
        off_map_robots.start_in_right(world.map, trial.number) if trial.change == "half" else None
    )
    simulation = CrowdSimulation(world, trial.number, trial.people, start=start)
    steps = []
    for step in simulated_steps(simulation, BridgeSettings()):
        steps.append(step)
        if len(steps) == trial.steps:
            break
        if trial.change == "kidnapped" and len(steps) == KIDNAPPED_AT:
            simulation.kidnap()
    grid_map = off_map_robots.without_right(world.map) if trial.change == "half" else world.map
    return grid_map, steps


def with_spinning_wheels(steps: TrueSteps, rng: np.random.Generator) -> TrueSteps:
    """Return steps of a robot whose wheels spin now and then: odometry reports a drive."""
    turned = []
    spun = last = np.zeros(3)
    for scan, truth in steps:
        now = np.array(scan.odom_from_robot)
        spun, last = compose(spun, between(last, now)), now
        if rng.random() < SPINNING_SHARE:
            spun = compose(spun, np.array([SPUN_M, 0.0, 0.0]))
        turned.append((msgspec.structs.replace(scan, odom_from_robot=pose_tuple(spun)), truth))
    return turned


@cache
def _all_steps(case: runs.Case) -> tuple[GridMap, TrueSteps]:
    made = course_of(case, 0, BridgeSettings())
    return made.map, [(scan, truth) for scan, truth in made.steps if truth is not None]


def recorded_steps(case: runs.Case, from_share: float, count: int) -> tuple[GridMap, TrueSteps]:
    """Return some steps of a recording that have a true pose, from a share of its steps on."""
    grid_map, steps = _all_steps(case)
    first = min(round(from_share * len(steps)), max(len(steps) - count, 0))
    return grid_map, steps[first : first + count]
