"""`clustermcl replay`: recompute a flight recording, and print its events and beliefs."""

from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, time
from pathlib import Path
from typing import TypeAlias

import typer

from clustermcl.commands.as_text import belief_line
from clustermcl.coordinator.recorder.records import Happened
from clustermcl.coordinator.recorder.replay import Believed, CoordinatorActs, Happening, replayed
from clustermcl.protocol.errors import SettingsError, escaped, printable
from clustermcl.runtime.version import VERSION

AROUND = 5
"""``--at`` prints this many seconds, or steps, before and after."""
_DAY_S = 86_400.0


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
    raise SettingsError(key=option, problem=problem)


def _since(moment: Moment, step: int, clock: datetime) -> float:
    """Return the steps, or the seconds, from a moment to a step or its time."""
    match moment:
        case int():
            return step - moment
        case datetime():
            return (clock - moment).total_seconds()
        case time():
            return (clock - datetime.combine(clock, moment)).total_seconds()


@dataclass(frozen=True)
class Shown:
    """The part of a recording that is printed."""

    first: Moment | None = None
    last: Moment | None = None
    around: Moment | None = None
    """Print `AROUND` before and after this, instead of from `first` to `last`."""
    above: float = 0.0
    """Least probability of clusters that began or ended."""

    def includes(self, happening: Happening, step: int, clock: datetime) -> bool:
        if isinstance(happening, Happened) and happening.probability < self.above:
            return False
        first, last, around = self.first, self.last, self.around
        if around is not None:
            off = abs(_since(around, step, clock))
            return (min(off, _DAY_S - off) if isinstance(around, time) else off) <= AROUND
        is_after = first is None or _since(first, step, clock) >= 0.0
        is_before = last is None or _since(last, step, clock) <= 0.0
        if isinstance(first, time) and isinstance(last, time) and first > last:
            return is_after or is_before  # over midnight
        return is_after and is_before


def print_replay(folder: Path, shown: Shown) -> bool:
    """Recompute a whole recording; return whether every belief equals the recorded one."""
    coordinators, step, printed = 0, -1, ""
    same: Counter[bool | None] = Counter()
    for wall_ns, happening in replayed(folder, VERSION):
        match happening:
            case CoordinatorActs():
                coordinators += 1
            case Believed(belief, is_same):
                same[is_same] += 1
                step = belief.step
        clock = datetime.fromtimestamp(wall_ns / 1e9)  # local, like the log
        if shown.includes(happening, step, clock):
            text = escaped(_as_text(happening))
            line = f"{clock:%Y-%m-%d %H:%M:%S}.{clock.microsecond // 1000:03d} {text}"
            if line != printed:  # shards of a search repeat its end
                typer.echo(line)
            printed = line
    typer.echo(_result(same, coordinators))
    return not same[False]


def _result(same: Counter[bool | None], coordinators: int) -> str:
    of = f"{same.total()} beliefs, {coordinators} coordinators"
    if same[False]:
        return f"{of}: {same[False]} beliefs differ from the recorded ones"
    if not same[True]:
        return f"{of}: no belief was recorded"
    return f"{of}: all as recorded, bit for bit"


def _as_text(happening: Happening) -> str:
    match happening:
        case Happened(kind, about):
            return f"{kind}: {printable(about)}" if about else kind
        case CoordinatorActs(sender, term, after_step):
            how = "begins empty" if after_step is None else f"takes over after step {after_step}"
            return f"coordinator {sender}, term {term}: {how}"
        case Believed(belief, same):
            remark = {
                True: "",
                False: "; differs from the recorded belief",
                None: "; not recorded",
            }[same]
            return belief_line(belief) + remark
