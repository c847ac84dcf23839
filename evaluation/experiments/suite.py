"""Runs experiments side by side and keeps what they came to, also when interrupted."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from evaluation.experiments.case import Algorithm, Case
from evaluation.experiments.parallel import Advanced, Done, Failed, in_parallel
from evaluation.experiments.provenance import Provenance
from evaluation.experiments.results import ExperimentResult, RunRecord, write_result
from evaluation.experiments.task import Finished, Task, run_task
from evaluation.experiments.trace import Trace
from process_runtime.stop import StopFlag

Traces = dict[str, dict[Algorithm, Trace]]
"""By the experiment's name, then by algorithm."""


@dataclass(frozen=True)
class Ended:
    """A run has ended, one way or another."""

    task: Task
    record: RunRecord
    completed: ExperimentResult | None
    """The experiment, if this was its last run."""


@dataclass(frozen=True)
class GotOn:
    """A run has made so many updates more."""

    task: Task
    updates: int


@dataclass
class Suite:
    """Experiments and what they have come to so far.

    Args:
        cases: the experiments.
        provenance: put into their files.
        folder: where their files are written.
    """

    cases: Sequence[Case]
    provenance: Provenance
    folder: Path
    results: list[ExperimentResult] = field(init=False)
    traces: Traces = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self.results = [ExperimentResult(case=c, provenance=self.provenance) for c in self.cases]

    def run(
        self,
        tasks: Sequence[Task],
        jobs: int,
        stop: StopFlag,
        tell: Callable[[Ended | GotOn], None],
    ) -> None:
        """Run all tasks; write an experiment's file each time one of its runs ends.

        Args:
            tasks: runs of the cases.
            jobs: how many at a time.
            stop: ends everything; what has ended is kept.
            tell: told what happens.

        Raises:
            OutputError: a file cannot be written.
        """
        for event in in_parallel(run_task, tasks, jobs, stop):
            task = tasks[event.piece]
            match event:
                case Advanced(amount=amount):
                    tell(GotOn(task, amount))
                case Done(result=finished):
                    tell(self._take(task, _record(task, finished), finished.trace))
                case Failed(problem=problem):
                    tell(self._take(task, _failed(task, problem), None))

    @property
    def failed(self) -> int:
        """How many runs failed."""
        return sum(run.problem is not None for result in self.results for run in result.runs)

    @property
    def begun(self) -> list[ExperimentResult]:
        """Experiments with at least one run."""
        return [result for result in self.results if result.runs]

    def _take(self, task: Task, record: RunRecord, trace: Trace | None) -> Ended:
        result = next(each for each in self.results if each.case.name == task.case.name)
        result.runs.append(record)
        if trace is not None:
            self.traces.setdefault(task.case.name, {})[task.algorithm] = trace
        write_result(result, self.folder)
        return Ended(task, record, result if result.complete else None)


def _record(task: Task, finished: Finished) -> RunRecord:
    return RunRecord(
        algorithm=task.algorithm,
        seed=task.seed,
        measures=finished.measures,
        reliability=finished.reliability,
        places_reliability=finished.places_reliability,
    )


def _failed(task: Task, problem: str) -> RunRecord:
    return RunRecord(algorithm=task.algorithm, seed=task.seed, problem=problem)
