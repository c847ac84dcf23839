"""The output of a running demo: a live table, or lines without a terminal."""

import math
from collections import deque
from types import TracebackType
from typing import Protocol, Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from clustermcl.as_text import (
    belief_line,
    event_line,
    is_unweighed,
    pose_text,
    progress_text,
    spread,
    spread_text,
)
from protocol.answers import Belief
from protocol.job_events import NumberedEvent
from protocol.message import PoseTuple

_LINE_EVERY_STEPS = 25
_SHOWN_EVENTS = 3
_COLUMNS = (
    "place", "probability", "", "x [m]", "y [m]", "heading", "+- [m]", "+- deg", "steps",
)  # fmt: skip


class View(Protocol):
    """Shows what happens, within a ``with`` block."""

    def __enter__(self) -> Self:
        """Begin."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """End."""

    def starting(self, ready: int, workers: int) -> None:
        """`ready` of the workers are ready."""

    def believed(self, belief: Belief, truth: PoseTuple | None) -> None:
        """A step was applied; `truth` is where the robot really was, if that is known."""

    def happened(self, event: NumberedEvent) -> None:
        """A cluster or a search began or ended."""


class NoView:
    """Shows nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_how: object) -> None:
        pass

    def starting(self, ready: int, workers: int) -> None:
        """Show nothing."""

    def believed(self, belief: Belief, truth: PoseTuple | None) -> None:
        """Show nothing."""

    def happened(self, event: NumberedEvent) -> None:
        """Show nothing."""


class LineView(NoView):
    """A line whenever the state or the number of places changes, and now and then.

    Args:
        console: where to.
        title: what is shown.
    """

    def __init__(self, console: Console, title: str) -> None:
        self._console, self._title = console, title
        self._said: tuple[object, ...] = ()

    def __enter__(self) -> Self:
        self._console.print(self._title, highlight=False, markup=False)
        return self

    def starting(self, ready: int, workers: int) -> None:
        """Print the first and the last state of the start."""
        if ready in (0, workers):
            self._say((ready,), f"{ready} of {workers} workers are ready")

    def believed(self, belief: Belief, truth: PoseTuple | None) -> None:  # noqa: ARG002 - the view's
        """Print changes, and a line now and then."""
        news = (
            *(belief.state, is_unweighed(belief), len(belief.hypotheses)),
            belief.step // _LINE_EVERY_STEPS,
        )
        self._say(news, belief_line(belief))

    def happened(self, event: NumberedEvent) -> None:
        """Print why a place began or ended."""
        if not event.event.is_search:
            self._print(event_line(event))

    def _say(self, news: tuple[object, ...], line: str) -> None:
        if news != self._said:
            self._said = news
            self._print(line)

    def _print(self, line: str) -> None:
        self._console.print(line, highlight=False, markup=False, soft_wrap=True)


class LiveView:
    """A table of the places and their probabilities, redrawn several times a second.

    Args:
        console: a terminal.
        title: what is shown.
        steps: how many there will be; None: unknown.
    """

    def __init__(self, console: Console, title: str, steps: int | None) -> None:
        self._title = Text(title)
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
        )
        self._task = self._progress.add_task("starting", total=steps)
        self._belief: Belief | None = None
        self._truth: PoseTuple | None = None
        self._events: deque[str] = deque(maxlen=_SHOWN_EVENTS)
        self._live = Live(console=console, get_renderable=self._render, refresh_per_second=8)

    def __enter__(self) -> Self:
        self._live.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._live.__exit__(kind, error, traceback)

    def starting(self, ready: int, workers: int) -> None:
        """Show how far the start is."""
        self._progress.update(
            self._task,
            description=f"{ready} of {workers} workers are ready (the first start compiles)",
        )

    def believed(self, belief: Belief, truth: PoseTuple | None) -> None:
        """Show it with the next redrawing."""
        self._belief, self._truth = belief, truth
        self._progress.update(self._task, completed=belief.step + 1, description="steps")

    def happened(self, event: NumberedEvent) -> None:
        """Show why places began or ended recently."""
        if not event.event.is_search:
            self._events.append(event_line(event))

    def _render(self) -> RenderableType:
        belief, truth = self._belief, self._truth
        if belief is None:
            return Group(self._title, self._progress)
        done = progress_text(belief.search_progress)
        search = f"  (a search for other places runs{done})" if belief.searching else ""
        blind = "  (blind: no worker has weighed this step)" if is_unweighed(belief) else ""
        lines = [f"step {belief.step}  [bold]{belief.state}[/bold]{search}{blind}"]
        if belief.hypotheses:
            best = belief.hypotheses[0]
            lines.append(f"pose   {pose_text(best.mean)}  {spread_text(best.covariance)}")
        if truth is not None:
            lines.append(f"truth  {pose_text(truth)}")
        lines += self._events
        return Group(self._title, _table(belief), *lines, self._progress)


_PLACES = 10
"""Shown one by one."""


def _table(belief: Belief) -> Table:
    """One line a place, within 80 columns; the less probable ones in one, and being elsewhere."""
    table = Table(box=None, padding=(0, 1, 0, 0), header_style="bold")
    for name in _COLUMNS:
        table.add_column(Text(name), justify="right", no_wrap=True)
    for hypothesis in belief.hypotheses[:_PLACES]:
        x, y, heading = hypothesis.mean
        position_m, heading_rad = spread(hypothesis.covariance)
        table.add_row(
            str(hypothesis.cluster),
            f"{hypothesis.probability:.3f}",
            ProgressBar(total=1.0, completed=hypothesis.probability, width=12),
            f"{x:.2f}",
            f"{y:.2f}",
            f"{math.degrees(heading):.1f}",
            f"{position_m:.2f}",
            f"{math.degrees(heading_rad):.1f}",
            str(hypothesis.age_steps),
        )
    if others := belief.hypotheses[_PLACES:]:
        _add_sum(table, f"{len(others)} more", sum(other.probability for other in others))
    off_map = belief.off_map_probability
    _add_sum(table, "elsewhere", belief.elsewhere_probability - off_map)
    _add_sum(table, "off the map", off_map)
    return table


def _add_sum(table: Table, name: str, probability: float) -> None:
    table.add_row(
        name, f"{probability:.3f}", ProgressBar(total=1.0, completed=probability, width=12)
    )
