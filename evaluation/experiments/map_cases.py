"""The experiments in maps of real buildings, with simulated robots: no choice was made on them."""

from pathlib import Path

from evaluation.experiments.case import Case, SimulatedRobot
from evaluation.experiments.figures import mean, rate
from evaluation.experiments.usual_figures import CONFIDENTLY_WRONG, RIGHT_FOR_GOOD, RMSE, SCORES

MAP_FOLDERS = ("carmen-maps", "ros-maps")
_OF_TRAINING_BUILDINGS = ("thickwean", "wean5300")
"""They show Wean Hall, on recordings of which constants were chosen."""


def map_cases(folder: Path | None) -> tuple[Case, ...]:
    """An experiment for each map, `carmen-maps/*.yaml` and `ros-maps/*.yaml` of a folder.

    Args:
        folder: None, or one that does not exist: there are none.
    """
    if folder is None:
        return ()
    maps = (path for name in MAP_FOLDERS for path in sorted((folder / name).glob("*.yaml")))
    return tuple(_case(path) for path in maps if path.stem not in _OF_TRAINING_BUILDINGS)


def _case(map_file: Path) -> Case:
    return Case(
        name=f"map-{map_file.stem.replace('_', '-')}",
        title=f"A simulated robot in the map {map_file.stem}, started anywhere",
        robot=SimulatedRobot(world=str(map_file)),
        role="test",
        updates=100,
        typical_updates=100,
        seeds=8,
        update_ms=40.0,
        ordinary_update_ms=25.0,
        figures=(
            rate("right on the last 10 updates", "localized", at_least=1, wanted=None),
            *RIGHT_FOR_GOOD,
            mean("updates to the first 5 right ones in a row", "right_within"),
            RMSE,
            CONFIDENTLY_WRONG,
            *SCORES,
        ),
    )
