"""What is going to be run: which experiments, how often, in which order, for how long."""

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from evaluation.experiments.case import Case, names_of, quick
from evaluation.experiments.task import Task
from process_runtime.settings import Settings
from process_runtime.settings_file import load_settings
from protocol.errors import ClusterMclError

QUICK_SEEDS, QUICK_UPDATES = 2, 120


class UnknownExperimentError(ClusterMclError):
    """No experiment has the name that was asked for."""

    def __init__(self, name: str, known: Sequence[Case], without: str) -> None:
        self.name = name
        near = difflib.get_close_matches(name, [case.name for case in known], n=1)
        hint = f", did you mean {near[0]}?" if near else f"; known are {names_of(known)}"
        super().__init__(f"no experiment {name!r}{hint}{without}")


@dataclass(frozen=True, kw_only=True)
class Extent:
    """How much is run."""

    seeds: int | None = None
    """Runs of each experiment and algorithm; None: each experiment's default."""
    first_seed: int = 0
    all_asked: bool = False
    """As many seeds as the targets are stated for, however long it takes."""
    quick: bool = False
    """Two short runs each, to see that everything works."""


def chosen(cases: Sequence[Case], names: Sequence[str], without: str) -> tuple[Case, ...]:
    """The experiments of the given names, in their own order; all, if none is given.

    Args:
        cases: all there are.
        names: asked for.
        without: what is missing and why, for the error.

    Raises:
        UnknownExperimentError: a name is not among them.
    """
    known = {case.name for case in cases}
    for name in names:
        if name not in known:
            raise UnknownExperimentError(name, cases, without)
    return tuple(case for case in cases if not names or case.name in names)


def extended(case: Case, extent: Extent) -> Case:
    """The experiment with as many runs as are asked for."""
    seeds = case.seeds
    asked = case.asked_seeds or seeds
    if extent.all_asked:
        seeds = asked
    if extent.quick:
        case = quick(case, QUICK_UPDATES)
        seeds = min(seeds, QUICK_SEEDS)
    if extent.seeds is not None:
        seeds = extent.seeds
    return msgspec.structs.replace(case, seeds=seeds, asked_seeds=asked)


@dataclass(frozen=True)
class Given:
    """Settings as a person gives them."""

    file: Path | None = None
    assignments: Sequence[str] = ()
    """`section.key=value`, over the file's."""

    def settings(self, more: Sequence[str] = ()) -> Settings:
        """The settings; an experiment's own assignments, `more`, go over all.

        Raises:
            InputFileError: the file cannot be read.
            SettingsError: a setting is unknown, of the wrong type or out of its range.
        """
        return load_settings(self.file, [*self.assignments, *more])


def tasks_of(
    cases: Sequence[Case], first_seed: int, given: Given, cache_folder: Path
) -> list[Task]:
    """All runs: those of the first seed of all experiments, then of the second, and so on.

    So an interrupted evening has something of everything, and the experiments with many short
    runs fill the cores to the end.

    Raises:
        ClusterMclError: a setting is wrong.
    """
    found: list[tuple[int, Task]] = []
    for case in cases:
        settings = given.settings(case.settings)
        for algorithm in case.algorithms:
            for index in range(case.seeds):
                task = Task(
                    case=case,
                    algorithm=algorithm,
                    seed=first_seed + index,
                    settings=settings,
                    cache_folder=cache_folder,
                    with_trace=index == 0,
                )
                found.append((index, task))
    found.sort(key=lambda each: (each[0], -each[1].case.run_ms(each[1].algorithm)))
    return [task for _, task in found]


def estimated_s(tasks: Sequence[Task], jobs: int) -> float:
    """How long all runs take in so many processes, by what updates took when measured."""
    runs_ms = [task.case.run_ms(task.algorithm) for task in tasks]
    longest_ms = max(runs_ms, default=0.0)
    return max(sum(runs_ms) / jobs, longest_ms) / 1e3
