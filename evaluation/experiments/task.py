"""One run of an experiment: an algorithm on a robot's steps, with an observer."""

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from coordinator.belief.outcome import Outcome, belief_after
from evaluation.experiments.case import ALGORITHMS, Algorithm, Case
from evaluation.experiments.course import Course, course_of
from evaluation.experiments.measures import Counts, RunMeasures
from evaluation.experiments.observer import Observer
from evaluation.experiments.trace import Trace
from evaluation.references import OnPose, written_trajectory
from particle_filter.sensor_model import SensorModel
from process_runtime.settings import Settings
from protocol.errors import MapFileError
from protocol.message import PoseTuple
from protocol.steps import Scan
from recordings.run_log import RunLog
from worker.map_model import default_cache_folder, sensor_model


@dataclass(frozen=True, kw_only=True)
class Task:
    """The specification of a run."""

    case: Case
    algorithm: Algorithm
    seed: int
    settings: Settings
    """Settings including the case's, except for the seed."""
    cache_folder: Path = field(default_factory=default_cache_folder)
    """Folder for computed likelihood fields."""
    start_step: int = 0
    """First step of a recording, as if the robot had been switched on there."""
    with_trace: bool = False
    record: Path | None = None
    """File for a bag of the run; None: none."""
    tum: Path | None = None
    """File for the most probable pose of each step; None: none."""


@dataclass(frozen=True, kw_only=True)
class Finished:
    """The result of a run."""

    measures: RunMeasures
    calibration: Counts
    """See `calibration_of`."""
    trace: Trace | None


def run_task(task: Task, on_update: Callable[[], None] | None = None) -> Finished:
    """Run a task from the first step to the last.

    Args:
        task: the specification.
        on_update: called after each update.

    Raises:
        ClusterMclError: an input cannot be used.
    """
    run = Run(task)
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    for _ in run.outcomes():
        if on_update is not None:
            on_update()
    observer = run.observer
    return Finished(
        measures=observer.measures(time.perf_counter() - wall_s, time.process_time() - cpu_s),
        calibration=observer.calibration,
        trace=observer.trace,
    )


class Run:
    """A prepared run, with map, robot and observer.

    Raises:
        ClusterMclError: an input cannot be used.
    """

    def __init__(self, task: Task) -> None:
        case = task.case
        self.course = course_of(case, task.seed, task.settings.bridge, task.start_step)
        self._settings = msgspec.structs.replace(task.settings, seed=task.seed)
        self._model = _model(self.course, self._settings, task.cache_folder)
        self._follow = ALGORITHMS[task.algorithm]
        self.observer = Observer(case, task.seed, self.course.map, with_trace=task.with_trace)
        self._record, self._tum = task.record, task.tum

    def outcomes(self) -> Iterator[Outcome]:
        """Yield the algorithm's outcome of every step, lazily."""
        with _recorder(self._record) as recorder, written_trajectory(self._tum) as on_pose:
            yield from self._followed(recorder, on_pose)

    def _followed(self, recorder: RunLog | None, on_pose: OnPose) -> Iterator[Outcome]:
        truths: dict[int, PoseTuple | None] = {}
        observer = self.observer
        for scan, outcome in self._follow(self._scans(truths), self._model, self._settings):
            observer.on_step(scan, outcome, truths.pop(scan.step))
            if recorder is not None:
                self._tell(recorder, scan, outcome)
            if outcome.hypotheses:
                on_pose(scan.stamp_ns, outcome.hypotheses[0].mean)
            yield outcome
            if observer.over:
                return
            if observer.kidnap_now:
                self.course.kidnap()
                observer.kidnapped()

    def _tell(self, recorder: RunLog, scan: Scan, outcome: Outcome) -> None:
        if recorder.wants_map(scan):
            recorder.on_map(self.course.map, scan.stamp_ns)
        recorder.on_scan(scan)
        recorder.on_belief(belief_after(scan, outcome, scan.sender))

    def _scans(self, truths: dict[int, PoseTuple | None]) -> Iterator[Scan]:
        """Yield the scans and store the truth of each."""
        for scan, truth in self.course.steps:
            truths[scan.step] = truth
            yield scan


def _recorder(file: Path | None) -> AbstractContextManager[RunLog | None]:
    return nullcontext() if file is None else RunLog.to(file)


def _model(course: Course, settings: Settings, cache_folder: Path) -> SensorModel:
    """Return the sensor model of the map, from the cache that all runs share."""
    try:
        return sensor_model(course.map, settings.sensor, cache_folder)
    except ValueError as error:  # there is nothing in the map to measure against
        raise MapFileError(course.map_name, str(error)) from error
