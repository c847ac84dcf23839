"""All experiments: simulated worlds, maps of real buildings, and recordings in a folder."""

import os
from collections.abc import Iterator
from pathlib import Path

from benchmarks.experiments.case import (
    Case,
    OnceRight,
    RecordedRobot,
    Role,
    SimulatedRobot,
)
from benchmarks.wean import WeanRobot

DATA_VARIABLE = "CLUSTERMCL_DATA"
"""Environment variable with the folder of recordings."""
MAP_FOLDERS = ("carmen-maps", "ros-maps")
STARTS, STEPS_OF_A_START = 20, 60
_TOO_SHORT = {"crob-jarvis"}
"""Recordings of hardly more steps than a start has: all starts would be the first step."""
_TRAINING_RECORDINGS = ("intel", "fr101")
"""Recordings on which the evidence model was fitted, with those of Wean Hall."""
_TRAINING_MAPS = ("thickwean", "wean5300")
"""Files that show Wean Hall."""
_PACKED = ("", ".xz", ".gz")


class StartsCase(Case, frozen=True, kw_only=True):
    """Runs that start at steps spread evenly over a recording; the seed is the start's number."""


_SIMULATED = (
    Case(
        name="cross",
        title="four places alike, 3,000 updates",
        robot=SimulatedRobot(world="cross"),
        role="training",
        updates=3000,
        symmetry=4,
        seeds=20,
    ),
    Case(
        name="rectangle",
        title="two places alike, 3,000 updates",
        robot=SimulatedRobot(world="rectangle"),
        role="training",
        updates=3000,
        symmetry=2,
        seeds=20,
    ),
    Case(
        name="hall-symmetric",
        title="a point-symmetric hall of 450 m2, 3,000 updates",
        robot=SimulatedRobot(world="hall_symmetric"),
        role="training",
        updates=3000,
        symmetry=2,
        seeds=20,
    ),
    Case(
        name="gates",
        title="a two-fold symmetric room; one missing cabinet, seen late, tells",
        robot=SimulatedRobot(world="gates"),
        role="training",
        updates=400,
        updates_after_event=40,
        symmetry=2,
        has_feature=True,
        seeds=40,
    ),
    Case(
        name="cross-feature",
        title="the cross with one cabinet at the end of one arm",
        robot=SimulatedRobot(world="cross_feature"),
        updates=400,
        updates_after_event=40,
        symmetry=4,
        has_feature=True,
        seeds=20,
    ),
    Case(
        name="hall",
        title="a hall of 450 m2, started anywhere",
        robot=SimulatedRobot(world="hall"),
        role="training",
        updates=100,
        seeds=40,
    ),
    Case(
        name="office",
        title="a repetitive office of 5,900 m2, started anywhere",
        robot=SimulatedRobot(world="office"),
        role="training",
        updates=205,
        seeds=24,
    ),
    Case(
        name="kidnap-hall",
        title="moved to another place of the hall after 40 right updates in a row",
        robot=SimulatedRobot(world="hall", kidnapping=OnceRight(100)),
        role="training",
        updates=205,
        updates_after_event=105,
        seeds=24,
    ),
    Case(
        name="kidnap-office",
        title="moved to another place of the office after 40 right updates in a row",
        robot=SimulatedRobot(world="office", kidnapping=OnceRight(250)),
        role="training",
        updates=455,
        updates_after_event=205,
        seeds=24,
    ),
    Case(
        name="hall-moved",
        title="the hall, started where the furniture was moved",
        robot=SimulatedRobot(world="hall_moved"),
        role="training",
        updates=105,
        seeds=20,
    ),
    Case(
        name="hall-last-year",
        title="the hall with an old map: a tenth of the walls was moved",
        robot=SimulatedRobot(world="hall_last_year"),
        updates=105,
        seeds=20,
    ),
    Case(
        name="people",
        title="the hall with people, who cut 30 % of the beams short",
        robot=SimulatedRobot(world="hall", people=22),
        role="training",
        updates=300,
        seeds=20,
    ),
)


def all_cases(folder: Path | None = None) -> tuple[Case, ...]:
    """Return all experiments that can be run.

    Args:
        folder: recordings and maps; None: the folder in `CLUSTERMCL_DATA`. Without an existing
            folder only the simulated experiments are returned.
    """
    named = os.environ.get(DATA_VARIABLE)
    folder = folder or (Path(named) if named else None)
    if folder is None or not folder.is_dir():
        return _SIMULATED
    recorded = recorded_cases(folder)
    starts = (_starts_of(case) for case in recorded if case.name not in _TOO_SHORT)
    return (*_SIMULATED, *recorded, *starts, *_map_cases(folder))


def recorded_cases(folder: Path | None) -> tuple[Case, ...]:
    """Return an experiment for each recording that has a map and a reference trajectory.

    Those of Wean Hall are `wean/robotdata1.log` and so on. Any other has its own folder with
    `log.clf`, `map.yaml` and `groundtruth.tum`; logs may be compressed (.gz, .xz).

    Args:
        folder: the folder; empty result if it is None or does not exist.
    """
    return tuple(_recorded(folder)) if folder is not None and folder.is_dir() else ()


def _recorded(folder: Path) -> Iterator[Case]:
    wean = folder / "wean"
    for number in (1, 2, 3):
        reference = wean / f"robotdata{number}.reference.tum"
        log = _packed(wean / f"robotdata{number}.log")
        if log and reference.is_file():
            robot = WeanRobot(recording=log, map=wean / "map.yaml", reference=reference)
            title = f"Wean Hall, recording {number}"
            yield Case(name=f"wean-{number}", title=title, robot=robot, role="training", seeds=20)
    for each in sorted(path for path in folder.iterdir() if path.is_dir()):
        log, reference = _packed(each / "log.clf"), each / "groundtruth.tum"
        if log and reference.is_file():
            role: Role = "training" if each.name in _TRAINING_RECORDINGS else "validation"
            robot = RecordedRobot(recording=log, map=each / "map.yaml", reference=reference)
            title = f"recording {each.name}"
            yield Case(name=each.name, title=title, robot=robot, role=role, seeds=3)


def _starts_of(case: Case) -> StartsCase:
    return StartsCase(
        name=f"{case.name}-starts",
        title=f"{case.title}, started at {STARTS} steps of it",
        robot=case.robot,
        updates=STEPS_OF_A_START,
        role=case.role,
        seeds=STARTS,
        baselines=(),
    )


def _map_cases(folder: Path) -> Iterator[Case]:
    """Return an experiment for each map of a building on which no constant was chosen."""
    for path in (path for name in MAP_FOLDERS for path in sorted((folder / name).glob("*.yaml"))):
        if path.stem not in _TRAINING_MAPS:
            yield Case(
                name=f"map-{path.stem.replace('_', '-')}",
                title=f"a simulated robot in the map {path.stem}, started anywhere",
                robot=SimulatedRobot(world=str(path)),
                role="test",
                updates=100,
                seeds=8,
            )


def _packed(path: Path) -> Path | None:
    """Return the path of a file that may be compressed."""
    candidates = (path.with_name(path.name + ending) for ending in _PACKED)
    return next((each for each in candidates if each.is_file()), None)
