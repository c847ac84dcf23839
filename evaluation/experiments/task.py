"""One run of one experiment: an algorithm on a robot's steps, watched from outside."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec

from coordinator.belief.outcome import Outcome
from evaluation import in_process, ordinary_mcl
from evaluation.experiments.case import Algorithm, Case
from evaluation.experiments.course import TrueStep, course_of
from evaluation.experiments.measures import RunMeasures
from evaluation.experiments.observer import Observer
from evaluation.experiments.reliability import Reliability
from evaluation.experiments.trace import Trace
from process_runtime.settings import Settings
from protocol.message import PoseTuple
from protocol.steps import Scan
from worker.map_model import sensor_model

_OUTCOMES = {"cluster-mcl": in_process.outcomes, "mcl": ordinary_mcl.outcomes}

PROGRESS_EVERY = 10
"""Updates between two words about how far a run is."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """What one run is of."""

    case: Case
    algorithm: Algorithm
    seed: int
    settings: Settings
    """With the case's own, but for the seed."""
    cache_folder: Path
    """Where computed fields of maps are kept."""
    with_trace: bool = False


@dataclass(frozen=True, kw_only=True)
class Finished:
    """What a run came to."""

    measures: RunMeasures
    reliability: Reliability
    """Of the estimates."""
    places_reliability: Reliability
    """Of all places held."""
    trace: Trace | None


def run_task(task: Task, progress: Callable[[int], None]) -> Finished:
    """Do one run from its first step to its last.

    Args:
        task: which.
        progress: told now and then how many updates more have been made.

    Raises:
        ClusterMclError: an input cannot be used.
    """
    case = task.case
    course = course_of(case, task.seed, task.settings.bridge)
    settings = msgspec.structs.replace(task.settings, seed=task.seed)
    model = sensor_model(course.map, settings.sensor, task.cache_folder)
    observer = Observer(case, task.seed, course.map, with_trace=task.with_trace)
    started_s = time.perf_counter()
    outcomes = _OUTCOMES[task.algorithm]
    followed = _paired(course.steps, lambda scans: outcomes(scans, model, settings))
    for made, (scan, outcome, truth) in enumerate(followed, start=1):
        observer.on_step(scan, outcome, truth)
        if made % PROGRESS_EVERY == 0:
            progress(PROGRESS_EVERY)
        if observer.over:
            break
        if observer.kidnap_now:
            course.kidnap()
            observer.kidnapped()
    return Finished(
        measures=observer.measures(time.perf_counter() - started_s),
        reliability=observer.reliability,
        places_reliability=observer.places_reliability,
        trace=observer.trace,
    )


def _paired(
    steps: Iterable[TrueStep],
    follow: Callable[[Iterator[Scan]], Iterator[tuple[Scan, Outcome]]],
) -> Iterator[tuple[Scan, Outcome, PoseTuple | None]]:
    """Outcomes with the true poses of their steps; one step is taken at a time."""
    truths: dict[int, PoseTuple | None] = {}

    def scans() -> Iterator[Scan]:
        for scan, truth in steps:
            truths[scan.step] = truth
            yield scan

    for scan, outcome in follow(scans()):
        yield scan, outcome, truths.pop(scan.step)
