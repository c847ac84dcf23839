"""The experiments on recordings: those that are found in a folder, by the names of their files."""

from pathlib import Path

from evaluation.experiments.case import Case, RecordedRobot, Role
from evaluation.experiments.figures import mean, rate
from evaluation.experiments.usual_figures import CONFIDENTLY_WRONG, RIGHT_FOR_GOOD, SCORES
from grid_maps.ros_map import parse_ros_header
from process_runtime.compressed import read_decompressed
from protocol.errors import MapFileError

DATA_VARIABLE = "CLUSTERMCL_DATA"
"""Environment variable that names the folder of recordings."""

WEAN_NAMES = ("wean-1", "wean-2", "wean-3")
_TRAINING = ("intel", "fr101")
"""Recordings, beside those of Wean Hall, on which the evidence model was fitted."""

_FINE_CELL_M = 0.05
_LASER_BASED_RMSE_M = 0.15
_PACKED = ("", ".xz", ".gz")

_TYPICAL = {"wean-1": 208, "wean-2": 437, "wean-3": 261, "fr079": 1737, "intel": 903}
"""Updates of a run, where known; for the estimate of time only."""


def recorded_cases(folder: Path | None) -> tuple[Case, ...]:
    """An experiment for each recording of a folder that has a map and a reference.

    Those of Wean Hall are `wean/robotdata1.log` and so on. Any other is a folder of its own with
    `log.clf`, `map.yaml` and `groundtruth.tum`; logs may be packed (.gz, .xz).

    Args:
        folder: None, or one that does not exist: there are none.
    """
    if folder is None or not folder.is_dir():
        return ()
    wean = [_wean(folder / "wean", number) for number in (1, 2, 3)]
    others = [_other(each) for each in sorted(folder.iterdir()) if each.is_dir()]
    return tuple(case for case in (*wean, *others) if case is not None)


def _wean(folder: Path, number: int) -> Case | None:
    log = _packed(folder / f"robotdata{number}.log")
    reference = folder / f"robotdata{number}.reference.tum"
    if log is None or not reference.is_file():
        return None
    return _case(
        f"wean-{number}",
        f"Wean Hall, recording {number}",
        (log, folder / "map.yaml", reference),
        role="training",
        seeds=10,
        asked_seeds=20,
    )


def _other(folder: Path) -> Case | None:
    log, reference = _packed(folder / "log.clf"), folder / "groundtruth.tum"
    if log is None or not reference.is_file():
        return None
    files = (log, folder / "map.yaml", reference)
    role: Role = "training" if folder.name in _TRAINING else "validation"
    return _case(folder.name, f"Recording {folder.name}", files, role=role, seeds=3)


def _case(
    name: str,
    title: str,
    files: tuple[Path, Path, Path],
    *,
    role: Role,
    seeds: int,
    asked_seeds: int | None = None,
) -> Case:
    recording, map_file, reference = files
    fine = _has_fine_cells(map_file)
    return Case(
        name=name,
        title=title,
        robot=RecordedRobot(recording=recording, map=map_file, reference=reference),
        role=role,
        seeds=seeds,
        asked_seeds=asked_seeds,
        typical_updates=_TYPICAL.get(name, 350),
        update_ms=13.0,
        ordinary_update_ms=11.0,
        figures=(
            rate("right on the last 10 updates", "localized", at_least=1),
            *RIGHT_FOR_GOOD,
            mean("right for good after", "settled_after_s", unit="s"),
            mean(
                "once right for good: root mean square error",
                "rmse_m",
                at_most=_LASER_BASED_RMSE_M if fine else None,
                unit="m",
            ),
            mean("share of the updates with the truth tracked", "tracked_share"),
            mean("mean probability of the truth", "truth_probability"),
            CONFIDENTLY_WRONG,
            *SCORES,
        ),
    )


def _packed(path: Path) -> Path | None:
    """A file under its name, or packed under it."""
    candidates = (path.with_name(path.name + ending) for ending in _PACKED)
    return next((each for each in candidates if each.is_file()), None)


def _has_fine_cells(map_file: Path) -> bool:
    """Whether the map's cells are 5 cm or less; a map that cannot be read fails in its runs."""
    try:
        header = parse_ros_header(read_decompressed(map_file, MapFileError), map_file)
    except MapFileError:
        return False
    return header.resolution <= _FINE_CELL_M + 1e-9
