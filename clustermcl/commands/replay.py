"""`clustermcl replay`: recompute a flight recording, and print its events and beliefs."""

import math
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from datetime import datetime, time
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from clustermcl.commands.as_text import belief_line
from clustermcl.commands.options import Above, argument, option
from clustermcl.coordinator.recorder import replay as flight
from clustermcl.coordinator.recorder.records import Happened
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.errors import RecordingError, SettingsError, escaped, printable
from clustermcl.protocol.why import why_text
from clustermcl.recordings.run_log import BELIEF, RunLogReader, decoded
from clustermcl.runtime.version import VERSION

EXIT_DIFFERENT = 1
ELSEWHERE = "elsewhere"
AROUND = 5
"""``--at`` prints this many seconds, or steps, before and after."""


Moment: TypeAlias = int | time | datetime
"""A step, a time of each day, or a date with a time, in local time."""


def parsed_moment(option: str, text: str | None) -> Moment | None:
    """Parse ``200``, ``11:45:51`` or ``2026-11-20 11:45:51``."""
    if text is None or text.isdecimal():
        return None if text is None else int(text)
    with suppress(ValueError):
        return time.fromisoformat(text).replace(tzinfo=None)
    with suppress(ValueError, OverflowError):
        return datetime.fromisoformat(text).astimezone().replace(tzinfo=None)
    problem = f"{text!r} is neither a step nor a time: 200, 11:45:51, '2026-11-20 11:45:51'"
    raise SettingsError(key=option, problem=f"{option}: {problem}")


def _since(moment: Moment, step: int, clock: datetime) -> float:
    """Return the steps, or the seconds, from a moment to a step or its time."""
    match moment:
        case int():
            return step - moment
        case datetime():
            return (clock - moment).total_seconds()
        case time():
            return (clock - datetime.combine(clock, moment)).total_seconds()


Bounds = Sequence[tuple[Moment | None, float, float]]
"""Moments, and how many steps or seconds after each a part begins and ends."""


def _includes(bounds: Bounds, step: int, clock: datetime) -> bool:
    return all(
        moment is None or least <= _since(moment, step, clock) <= most
        for moment, least, most in bounds
    )


def replay(
    folder: Annotated[Path, argument("FOLDER", "A robot's flight recording, or a file of it.")],
    first: Annotated[
        str | None, option("Print from this step or time on.", "WHEN", flag="--from")
    ] = None,
    last: Annotated[
        str | None, option("Print up to this step or time.", "WHEN", flag="--to")
    ] = None,
    at: Annotated[str | None, option("Print 5 seconds, or steps, around it.", "WHEN")] = None,
    above: Above = 0.0,
    why: Annotated[
        str | None, option("Print why this place (c7, or elsewhere) rose or fell.", "PLACE")
    ] = None,
) -> None:
    """Recompute a flight recording, and print what happened.

    `--why` also reads a run that was recorded otherwise, and recomputes nothing. WHEN is a
    step, or a local time: 200, 11:45:51, or '2026-11-20 11:45:51'. Exit code 1 if a belief
    differs from the recorded one.
    """
    if at and (first or last):
        raise SettingsError("--at with --from or --to: leave one out")
    shown = (
        (parsed_moment("--from", first), 0.0, math.inf),
        (parsed_moment("--to", last), -math.inf, 0.0),
        (parsed_moment("--at", at), -AROUND, AROUND),
    )
    if why is not None:
        _print_why(folder, _parsed_place(why), shown)
    elif not _print_replay(folder, shown, above):
        sys.exit(EXIT_DIFFERENT)


def _print_replay(folder: Path, shown: Bounds, above: float) -> bool:
    """Recompute a whole recording; return whether every belief equals the recorded one."""
    coordinators, step, printed = 0, -1, ""
    same: Counter[bool | None] = Counter()
    for wall_ns, happening in flight.replayed(folder, VERSION):
        match happening:
            case Happened() if happening.probability < above:
                continue
            case flight.CoordinatorActs():
                coordinators += 1
            case flight.Believed(belief, is_same):
                same[is_same] += 1
                step = belief.step
        clock = datetime.fromtimestamp(wall_ns / 1e9)  # local, like the log
        if _includes(shown, step, clock):
            text = escaped(_as_text(happening))
            line = f"{clock:%Y-%m-%d %H:%M:%S}.{clock.microsecond // 1000:03d} {text}"
            if line != printed:  # shards of a search repeat its end
                typer.echo(line)
            printed = line
    result = "all as recorded, bit for bit" if same[True] else "no belief was recorded"
    if same[False]:
        result = f"{same[False]} beliefs differ from the recorded ones"
    typer.echo(f"{same.total()} beliefs, {coordinators} coordinators: {result}")
    return not same[False]


def _as_text(happening: flight.Happening) -> str:
    match happening:
        case Happened(kind, about):
            return f"{kind}: {printable(about)}" if about else kind
        case flight.CoordinatorActs(sender, term, after_step):
            how = "begins empty" if after_step is None else f"takes over after step {after_step}"
            return f"coordinator {sender}, term {term}: {how}"
        case flight.Believed(belief, same):
            differs = {False: "; differs from the recorded belief", None: "; not recorded"}
            return belief_line(belief) + differs.get(same, "")


def _parsed_place(text: str) -> int | None:
    """Parse ``c7``, ``7`` or ``elsewhere``, which is None."""
    number = text.removeprefix("c")
    if text == ELSEWHERE:
        return None
    if number.isdecimal() and len(number) < 19:
        return int(number)
    raise SettingsError(key="--why", problem=f"--why: {text!r} is no place: c7, 7, or {ELSEWHERE}")


def _print_why(path: Path, place: int | None, shown: Bounds) -> None:
    """Print the causes of each change of a place, or of elsewhere (None), and their sums."""
    name = ELSEWHERE if place is None else f"place {place}"
    sums, steps, before = Counter[str](), list[int](), None
    for wall_ns, belief in _beliefs(path):
        tracked: dict[int | None, float]
        tracked = {each.cluster: each.probability for each in belief.hypotheses}
        tracked[None] = belief.elsewhere_probability - belief.off_map_probability
        probability = tracked.get(place)
        if probability is None and before is None:
            continue
        clock = datetime.fromtimestamp(wall_ns / 1e9)
        if _includes(shown, belief.step, clock):
            text = "no longer tracked"
            if probability is not None:
                index = list(tracked).index(place)
                text = why_text(belief.why, index)
                sums.update(belief.why.of(index))
            change = f"{100.0 * (before or 0.0):.1f} -> {100.0 * (probability or 0.0):.1f} %"
            line = f"{clock:%H:%M:%S} step {belief.step}: {name} {change}{text and '; '}{text}"
            typer.echo(escaped(line))
            steps.append(belief.step)
        before = probability
    if not steps:
        raise RecordingError(path, f"no belief of these steps contains {name}")
    total = ", ".join(f"{cause} {nat:+.1f}" for cause, nat in sums.most_common())
    total = total or "no reasons were recorded"
    typer.echo(escaped(f"steps {steps[0]} to {steps[-1]}, log odds in nat: {total}"))


def _beliefs(path: Path) -> Iterator[tuple[int, Belief]]:
    """Yield all beliefs with the wall clock [ns]; they are those that were published."""
    for file in flight.files_at(path):
        for message in RunLogReader(file).messages():
            if message.topic == BELIEF:
                yield message.at_ns, decoded(message, Belief, file)
