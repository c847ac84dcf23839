"""Experiments as a table: one row for each run, in a CSV file that is the only result.

A file that exists is continued: runs whose row it has are not repeated. So an interrupted run is
resumed by the same command, and a table can grow by seeds and algorithms.
"""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from msgspec.structs import asdict, fields, replace

from benchmarks.experiments.case import Algorithm, Case
from benchmarks.experiments.catalogue import StartsCase
from benchmarks.experiments.measures import BINS, RunMeasures
from benchmarks.experiments.task import Finished, Task
from clustermcl.commands.evaluate import start_steps
from clustermcl.evaluation.run import course_of
from clustermcl.protocol.errors import InputFileError
from clustermcl.runtime.output_files import OutputError
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_table import TABLE, value_of
from clustermcl.runtime.version import VERSION

_KEYS = ("experiment", "role", "algorithm", "seed", "start_step")
_ORIGIN = ("version", "settings")
_CLAIMS = tuple(f"{what}_{part}" for what in ("claims", "right", "claimed") for part in range(BINS))
"""Of the estimates in each tenth of probability: how many, how many right, sum of probabilities."""
COLUMNS = (*_KEYS, *(each.name for each in fields(RunMeasures)), *_CLAIMS, *_ORIGIN)
Key = tuple[str, str, str]
"""Experiment, algorithm and seed."""


def tasks_of(
    cases: Sequence[Case],
    algorithms: Sequence[Algorithm],
    seeds: range | None,
    settings: Settings,
) -> list[Task]:
    """All runs, the first seed of each experiment first: a table cut short has some of everything.

    Args:
        cases: the experiments.
        algorithms: to run; none: each experiment's own.
        seeds: to run; None: as many as each experiment has.
        settings: of all of them.
    """
    found = [
        (
            index,
            Task(case=case, algorithm=algorithm, seed=seed, settings=settings, start_step=start),
        )
        for case in cases
        for starts in [_starts_of(case, settings)]
        for algorithm in algorithms or case.algorithms
        for index, seed in enumerate(seeds or range(case.seeds))
        for start in [starts[seed % len(starts)]]
    ]
    return [task for _, task in sorted(found, key=lambda each: each[0])]


def _starts_of(case: Case, settings: Settings) -> Sequence[int]:
    """Return the first step of each run of a case; its runs use them in turn."""
    if not isinstance(case, StartsCase):
        return (0,)
    whole = course_of(replace(case, updates=None), 0, settings.bridge)
    steps, steps_each = sum(1 for _ in whole.steps), case.updates or 1
    # A recording that is hardly longer than a run has fewer starts.
    return start_steps(steps, min(case.seeds, max(steps - steps_each, 0) + 1), steps_each)


def key_of(task: Task) -> Key:
    """Which row a run is."""
    return task.case.name, task.algorithm, str(task.seed)


def rows_of(path: Path) -> list[dict[str, str]]:
    """The rows of a table.

    Raises:
        InputFileError: it cannot be read, or is no such table.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            columns, rows = list(reader.fieldnames or ()), list(reader)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputFileError(path, f"cannot be read as a table: {error}") from error
    if missing := set(COLUMNS) - set(columns):
        raise InputFileError(path, f"is no table of this version's runs: no column {min(missing)}")
    return rows


class RunTable:
    """A table to append rows to, created with its folder where it does not exist.

    Raises:
        OutputError: it cannot be written.
        InputFileError: it exists and is no table of runs, or its runs have other settings.
    """

    def __init__(self, path: Path, settings: Settings) -> None:
        self._path = path
        exists = path.exists() and path.stat().st_size > 0
        rows = rows_of(path) if exists else []
        if others := {row["settings"] for row in rows} - {" ".join(changed_settings(settings))}:
            problem = (
                f"its runs have {min(others) or 'the default settings'}; name another --output"
            )
            raise InputFileError(path, problem)
        self.done: set[Key] = {(r["experiment"], r["algorithm"], r["seed"]) for r in rows}
        """The runs that it has."""
        if not exists:
            self._write(dict(zip(COLUMNS, COLUMNS, strict=True)))

    def append(self, task: Task, finished: Finished) -> None:
        """Add a run; it is on disk when this returns."""
        measured = asdict(finished.measures)
        self._write(
            {
                "experiment": task.case.name,
                "role": task.case.role,
                "algorithm": task.algorithm,
                "seed": task.seed,
                "start_step": task.start_step,
                **{name: "" if value is None else value for name, value in measured.items()},
                **dict(zip(_CLAIMS, finished.calibration.ravel().tolist(), strict=True)),
                "version": VERSION,
                "settings": " ".join(changed_settings(task.settings)),
            }
        )
        self.done.add(key_of(task))

    def _write(self, row: dict[str, Any]) -> None:
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", newline="", encoding="utf-8") as file:
                csv.DictWriter(file, COLUMNS).writerow(row)
        except OSError as error:
            raise OutputError(path=self._path, problem=error.strerror or str(error)) from error


def changed_settings(settings: Settings) -> list[str]:
    """Settings that differ from the defaults, as `section.key=value`."""
    values = {name: value_of(settings, name) for name in TABLE if name != "seed"}
    return [f"{name}={value}" for name, value in values.items() if value != TABLE[name].default]
