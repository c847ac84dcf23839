"""`clustermcl replay --why PLACE`: print why a place became more or less probable."""

from collections import Counter
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import typer

from clustermcl.commands.replay import Shown
from clustermcl.coordinator.recorder.replay import Believed, files_at, nothing_in
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.errors import RecordingError, SettingsError, escaped
from clustermcl.protocol.why import why_text
from clustermcl.recordings.run_log import BELIEF, RunLogReader, decoded

ELSEWHERE = "elsewhere"


def parsed_place(text: str) -> int | None:
    """Parse ``c7``, ``7`` or ``elsewhere``, which is None."""
    number = text.removeprefix("c")
    if text == ELSEWHERE:
        return None
    if number.isdecimal() and len(number) < 19:
        return int(number)
    raise SettingsError(key="--why", problem=f"{text!r} is no place: c7, 7, or {ELSEWHERE}")


def print_why(path: Path, place: int | None, shown: Shown) -> None:
    """Print the causes of each change of a place, and their sums.

    Args:
        path: a recorded run, or a flight recording; it may still be written.
        place: number of the place; None: elsewhere.
        shown: the steps.

    Raises:
        RecordingError: no belief in it contains the place.
    """
    name = ELSEWHERE if place is None else f"place {place}"
    sums, steps, before, is_known = Counter[str](), list[int](), 0.0, False
    for wall_ns, belief in _beliefs(path):
        clusters = [each.cluster for each in belief.hypotheses]
        index = len(clusters) if place is None else _index(clusters, place)
        is_gone = index is None
        if index is None and not is_known:
            continue
        clock = datetime.fromtimestamp(wall_ns / 1e9)
        probability = _probability(belief, index)
        if shown.includes(Believed(belief, None), belief.step, clock):
            text = "no longer tracked" if index is None else why_text(belief.why, index)
            change = f"{100.0 * before:.1f} -> {100.0 * probability:.1f} %"
            line = f"{clock:%H:%M:%S} step {belief.step}: {name} {change}{text and '; '}{text}"
            typer.echo(escaped(line))
            steps.append(belief.step)
            sums.update({} if index is None else belief.why.of(index))
        before, is_known = probability, not is_gone
    if not steps:
        raise RecordingError(path, f"no belief of these steps contains {name}")
    total = ", ".join(f"{cause} {nat:+.1f}" for cause, nat in sums.most_common())
    total = total or "no reasons were recorded"
    typer.echo(escaped(f"steps {steps[0]} to {steps[-1]}, log odds in nat: {total}"))


def _index(clusters: list[int], place: int) -> int | None:
    return clusters.index(place) if place in clusters else None


def _probability(belief: Belief, index: int | None) -> float:
    if index is None:
        return 0.0
    if index == len(belief.hypotheses):
        return belief.elsewhere_probability - belief.off_map_probability
    return belief.hypotheses[index].probability


def _beliefs(path: Path) -> Iterator[tuple[int, Belief]]:
    """Yield all beliefs with the wall clock [ns]; they are those that were published."""
    files = files_at(path)
    if not files:
        raise RecordingError(path, nothing_in(path))
    for file in files:
        for message in RunLogReader(file).messages():
            if message.topic == BELIEF:
                yield message.at_ns, decoded(message, Belief, file)
