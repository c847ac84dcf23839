"""One run of an experiment: an algorithm on a robot's steps, with an observer."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.experiments.baselines import ALGORITHMS
from benchmarks.experiments.case import Algorithm, Case
from benchmarks.experiments.measures import Counts, RunMeasures
from benchmarks.experiments.observer import Observer
from clustermcl.belief.outcome import Outcome
from clustermcl.evaluation import run
from clustermcl.runtime.folders import kept_folder
from clustermcl.runtime.settings import Settings


@dataclass(frozen=True, kw_only=True)
class Task:
    """The specification of a run."""

    case: Case
    algorithm: Algorithm
    seed: int
    settings: Settings
    """Settings including the case's, except for the seed."""
    cache_folder: Path = field(default_factory=lambda: kept_folder("maps"))
    """Folder for computed likelihood fields."""
    start_step: int = 0
    """First step of a recording, as if the robot had been switched on there."""


@dataclass(frozen=True, kw_only=True)
class Finished:
    """The result of a run."""

    measures: RunMeasures
    calibration: Counts
    """See `calibration_of`."""


def run_task(task: Task) -> Finished:
    """Run a task from the first step to the last.

    Raises:
        ClusterMclError: an input cannot be used.
    """
    prepared = Run(task)
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    for _ in prepared.outcomes():
        pass
    observer = prepared.observer
    return Finished(
        measures=observer.measures(time.perf_counter() - wall_s, time.process_time() - cpu_s),
        calibration=observer.calibration,
    )


class Run:
    """A prepared run of an experiment, with its observer.

    Raises:
        ClusterMclError: an input cannot be used.
    """

    def __init__(self, task: Task) -> None:
        self._course, self._steps = run.Run(
            case=task.case,
            follow=ALGORITHMS[task.algorithm],
            seed=task.seed,
            settings=task.settings,
            start_step=task.start_step,
        ).begun(task.cache_folder)
        self.observer = Observer(task.case, self._course.map)

    def outcomes(self) -> Iterator[Outcome]:
        """Yield the algorithm's outcome of every step, lazily."""
        for scan, outcome, truth in self._steps:
            self.observer.on_step(scan, outcome, truth)
            yield outcome
            if self.observer.over:
                return
            if self.observer.kidnap_now and self._course.simulation is not None:
                self._course.simulation.kidnap()
                self.observer.kidnapped()
