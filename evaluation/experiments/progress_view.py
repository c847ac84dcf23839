"""What a person sees while experiments run: a bar, and a line for each experiment that ends."""

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from evaluation.experiments.case import NAMES
from evaluation.experiments.report_tables import figure_rows
from evaluation.experiments.results import ExperimentResult
from evaluation.experiments.suite import Ended, GotOn
from evaluation.experiments.task import Task
from process_runtime.logs import is_quiet


class ProgressView:
    """A bar of the estimated work and one of the runs.

    Args:
        console: where to; without a terminal only lines are printed.
        tasks: all that is going to be run.
    """

    def __init__(self, console: Console, tasks: list[Task]) -> None:
        self._console = console
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=console,
            disable=is_quiet() or not console.is_terminal,
        )
        work_ms = sum(task.case.run_ms(task.algorithm) for task in tasks)
        self._work = self._progress.add_task("estimated work [s]", total=round(work_ms / 1e3))
        self._runs = self._progress.add_task("runs", total=len(tasks))
        self._done_ms = 0.0
        self._begun_ms: dict[tuple[str, str, int], float] = {}

    def __enter__(self) -> Self:
        self._progress.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._progress.__exit__(kind, error, traceback)

    def tell(self, event: Ended | GotOn) -> None:
        """Show how far it is."""
        task = event.task
        key = (task.case.name, task.algorithm, task.seed)
        whole_ms = task.case.run_ms(task.algorithm)
        if isinstance(event, GotOn):
            share = event.updates / task.case.typical_updates
            self._begun_ms[key] = min(whole_ms, self._begun_ms.get(key, 0.0) + share * whole_ms)
        else:
            self._begun_ms.pop(key, None)
            self._done_ms += whole_ms
            self._progress.advance(self._runs)
            if event.record.problem is not None:
                self._say(f"failed: {' '.join(map(str, key))}: {event.record.problem}")
            if event.completed is not None:
                self._conclude(event.completed)
        done_s = (self._done_ms + sum(self._begun_ms.values())) / 1e3
        self._progress.update(self._work, completed=round(done_s))

    def _conclude(self, result: ExperimentResult) -> None:
        """Say what came of what was asked."""
        for figure, row in figure_rows(result):
            if figure.asks:
                beside = ", ".join(f"{NAMES[name]} {text}" for name, text in row.beside.items())
                met = {"yes": "met", "–": "nothing measured"}.get(row.met, "NOT met")
                self._say(
                    f"{result.case.name}: {row.text}: {row.measured} ({row.spread}), "
                    f"asked {row.target}: {met}; {beside}"
                )

    def _say(self, line: str) -> None:
        self._console.print(line, highlight=False, soft_wrap=True, markup=False)
