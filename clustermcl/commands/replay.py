"""`clustermcl replay`: recompute a flight recording, and print its events and beliefs."""

from collections import Counter
from dataclasses import dataclass, replace
from datetime import datetime, time
from pathlib import Path
from typing import Literal

import typer

from clustermcl.commands.as_text import belief_line
from clustermcl.coordinator.recorder.records import Happened
from clustermcl.coordinator.recorder.replay import Believed, CoordinatorActs, Happening, replayed
from clustermcl.protocol.errors import SettingsError, escaped, printable
from clustermcl.runtime.version import VERSION

AROUND = 5
"""``--at`` prints this many seconds, or steps, before and after."""
_DAY_S = 86_400.0


@dataclass(frozen=True)
class Moment:
    """A step, a date with a time [s since 1970], or a time of each day [s]."""

    kind: Literal["step", "time", "time of day"]
    value: float

    @classmethod
    def parsed(cls, option: str, text: str | None) -> "Moment | None":
        """Parse ``200``, ``11:45:51`` or ``2026-11-20 11:45:51``, in local time.

        Raises:
            SettingsError: the text is none of them.
        """
        if text is None:
            return None
        if text.isdecimal():
            return cls("step", float(text))
        try:
            return cls("time of day", _of_day_s(time.fromisoformat(text)))
        except ValueError:
            pass
        try:
            return cls("time", datetime.fromisoformat(text).timestamp())
        except (ValueError, OverflowError):
            problem = f"{text!r} is neither a step nor a time: 200, 11:45:51, '2026-11-20 11:45:51'"
            raise SettingsError(key=option, problem=problem) from None

    def shifted(self, by: float) -> "Moment":
        value = self.value + by
        return replace(self, value=value % _DAY_S if self.kind == "time of day" else value)

    def comparable(self, step: int, clock: datetime) -> float:
        """Return the step or the time, as a number that compares with `value`."""
        match self.kind:
            case "step":
                return step
            case "time":
                return clock.timestamp()
            case "time of day":
                return _of_day_s(clock.time())


@dataclass(frozen=True)
class Shown:
    """The part of a recording that is printed."""

    first: Moment | None = None
    last: Moment | None = None
    above: float = 0.0
    """Least probability of clusters that began or ended."""

    @classmethod
    def around(cls, moment: Moment, above: float) -> "Shown":
        return cls(moment.shifted(-AROUND), moment.shifted(AROUND), above)

    def includes(self, happening: Happening, step: int, clock: datetime) -> bool:
        first, last = self.first, self.last
        is_after = first is None or first.comparable(step, clock) >= first.value
        is_before = last is None or last.comparable(step, clock) <= last.value
        if isinstance(happening, Happened) and happening.probability < self.above:
            return False
        if first and last and first.kind == last.kind == "time of day" and first.value > last.value:
            return is_after or is_before  # over midnight
        return is_after and is_before


def print_replay(folder: Path, shown: Shown) -> bool:
    """Recompute a whole recording; return whether every belief equals the recorded one."""
    coordinators, step = 0, -1
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
            typer.echo(f"{clock:%Y-%m-%d %H:%M:%S}.{clock.microsecond // 1000:03d} {text}")
    typer.echo(_result(same, coordinators))
    return not same[False]


def _of_day_s(clock: time) -> float:
    return clock.hour * 3600.0 + clock.minute * 60.0 + clock.second + clock.microsecond / 1e6


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
