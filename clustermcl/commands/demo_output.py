"""The output of a demo: the beliefs while it runs, then a summary or a JSON object."""

import math
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, nullcontext

from rich.console import Console
from rich.live import Live
from rich.text import Text

from clustermcl.commands import as_text as text
from clustermcl.commands.as_json import JsonObject, json_object
from clustermcl.evaluation.measures import PoseError, pose_error
from clustermcl.protocol import job_events
from clustermcl.protocol.answers import Belief, Status
from clustermcl.protocol.errors import escaped
from clustermcl.protocol.message import PoseTuple
from clustermcl.runtime.logs import is_quiet

HELD_PROBABILITY = 0.02
"""Probability below which the summary ignores a place."""
_LINE_EVERY_STEPS = 25
_SHOWN_EVENTS, _SHOWN_PLACES, _BAR = 3, 10, 12


class DemoOutput:
    """The output of a running demo: a table on a terminal, otherwise a line for each change.

    Nothing is printed with ``--quiet``. With `as_json`, standard output is for the JSON object
    only: a table goes to standard error, and lines are not printed.
    """

    def __init__(self, title: str, *, as_json: bool) -> None:
        self._console = Console(stderr=as_json, emoji=False, markup=False, highlight=False)
        self._is_table = self._console.is_terminal and not is_quiet()
        self._has_lines = not (self._is_table or as_json or is_quiet())
        self._title, self._shown = title, title
        self._last_change: tuple[object, ...] = ()
        self._events: deque[str] = deque(maxlen=_SHOWN_EVENTS)

    def live(self) -> AbstractContextManager[object]:
        """Print the title; show the table, if there is one, within the ``with`` block."""
        self._print(self._title)
        if not self._is_table:
            return nullcontext()
        shown = lambda: Text(self._shown, no_wrap=True)  # noqa: E731 - one line
        return Live(console=self._console, get_renderable=shown, refresh_per_second=8)

    def on_workers(self, *, are_ready: bool, has_page: bool = False) -> None:
        line = "the workers start; the first start compiles"
        if are_ready:
            waits = "; the demo begins when the link is opened" if has_page else ""
            line = f"the workers are ready{waits}"
        self._shown = f"{self._title}\n{line}"
        self._print_change((are_ready,), line)

    def on_belief(self, belief: Belief, truth: PoseTuple | None) -> None:
        """Show a belief, and the true pose if it is known; lines show only changes."""
        self._shown = "\n".join([self._title, *_table(belief, truth), *self._events])
        change = belief.state, text.is_unweighed(belief), len(text.shown_places(belief))
        self._print_change((*change, belief.step // _LINE_EVERY_STEPS), text.belief_line(belief))

    def on_events(self, events: Iterable[job_events.NumberedEvent]) -> None:
        """Show events of places above `LEAST_SHOWN`; ignore those of searches."""
        shown = (
            each
            for each in events
            if job_events.probability_of(each.event) >= text.LEAST_SHOWN
            and not job_events.is_of_search(each.event)
        )
        for line in map(escaped, job_events.event_texts(shown)):
            self._events.append(line)
            self._print(line)

    def _print_change(self, change: tuple[object, ...], line: str) -> None:
        if change != self._last_change:
            self._last_change = change
            self._print(line)

    def _print(self, line: str) -> None:
        if self._has_lines:
            self._console.print(line, soft_wrap=True)


def _table(belief: Belief, truth: PoseTuple | None) -> Iterator[str]:
    """Yield a step's state, its places, elsewhere and off the map, and the true pose if known."""
    search = text.search_text(belief.search_progress, runs=True) if belief.searching else ""
    note = ", dead reckoning: no worker has weighed this step" if text.is_unweighed(belief) else ""
    yield f"step {belief.step}: {belief.state}{search}{note}"
    shown = text.shown_places(belief)[:_SHOWN_PLACES]
    for place in shown:
        yield _row(
            f"c{place.cluster}", place.probability, text.place_text(place.pose, place.covariance)
        )
    if others := belief.hypotheses[len(shown) :]:
        yield _row(f"{len(others)} more", sum(place.probability for place in others))
    yield _row("elsewhere", belief.elsewhere_probability - belief.off_map_probability)
    yield _row("off the map", belief.off_map_probability)
    if truth is not None:
        yield f"{'truth':>11}  {'':{_BAR + 8}}  {text.pose_text(truth)}"


def _row(name: str, probability: float, where: str = "") -> str:
    return f"{name:>11}  {probability:6.3f}  {'━' * round(_BAR * probability):{_BAR}}  {where}"


class DemoSummary:
    """A summary of all beliefs of a run, in constant memory."""

    def __init__(self) -> None:
        self.localized_steps = 0
        """Number of consecutive localized steps up to the newest step."""
        self.found_step: int | None = None
        """First step that was localized at the true pose."""
        self.belief: Belief | None = None
        self.truth: PoseTuple | None = None
        """The true pose of its step; None: unknown."""
        self._ambiguous_steps = self._most_places = 0
        self._first_places_step: int | None = None
        self._highest = 0.0

    def on_belief(self, belief: Belief, truth: PoseTuple | None = None) -> None:
        self.belief, self.truth = belief, truth
        self.localized_steps = self.localized_steps + 1 if belief.state == "localized" else 0
        if self.found_step is None and belief.state == "localized" and (error := self._error()):
            self.found_step = belief.step if error.right else None
        if belief.state != "searching" and self._first_places_step is None:
            self._first_places_step = belief.step
        if belief.state == "ambiguous":
            held = [h.probability for h in belief.hypotheses if h.probability >= HELD_PROBABILITY]
            self._ambiguous_steps += 1
            self._most_places = max(self._most_places, len(held))
            self._highest = max([self._highest, *held])

    def _error(self) -> PoseError | None:
        best = self.belief and self.belief.best
        return pose_error(best.pose, self.truth) if best and self.truth is not None else None

    def as_object(self, status: Status, wall_s: float) -> JsonObject:
        error = self._error()
        return {
            **(json_object(self.belief) if self.belief else {}),
            "steps": status.steps_applied,
            "steps_lost": status.steps_lost,
            "wall_s": wall_s,
            "found_step": self.found_step,
            "final_error_m": error.distance_m if error else None,
            "final_error_rad": error.heading_rad if error else None,
        }

    def lines(self, status: Status, wall_s: float) -> Iterator[str]:
        if self._first_places_step is not None:
            yield f"The search found its first places at step {self._first_places_step}."
        if self._ambiguous_steps:
            yield (
                f"For {self._ambiguous_steps} steps it was ambiguous: up to {self._most_places} "
                f"places had {HELD_PROBABILITY:.0%} or more, the best at most {self._highest:.2f}."
            )
        if self.found_step is not None:
            yield f"First localized at the true pose: step {self.found_step}."
        belief = self.belief
        if belief and self.localized_steps:
            since = belief.step - self.localized_steps + 1
            yield f"From step {since} on the robot was localized."
        if belief and belief.hypotheses:
            best = belief.hypotheses[0]
            where = text.place_text(best.pose, best.covariance)
            yield f"At the end {belief.state} with probability {best.probability:.2f}: {where}"
            if error := self._error():
                off_deg = math.degrees(error.heading_rad)
                yield f"That is {error.distance_m:.2f} m and {off_deg:.1f} deg off."
        elif belief:
            yield f"At the end {belief.state}; no place is known."
        yield (
            f"{status.steps_applied} steps, {status.steps_lost} lost, "
            f"{len(status.workers)} workers, {wall_s:.1f} s."
        )
