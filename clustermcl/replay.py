"""`clustermcl replay`: recompute a flight recording, and print its events and beliefs."""

import math
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

import typer

from clustermcl.as_text import belief_line
from coordinator.recorder.records import Happened
from coordinator.recorder.replay import Believed, CoordinatorActs, Happening, replayed
from process_runtime.version import VERSION
from protocol.errors import printable


def print_replay(folder: Path, *, first_step: int | None, last_step: int | None) -> bool:
    """Recompute a whole recording; return whether every belief equals the recorded one.

    The events and beliefs of some steps are printed.

    Args:
        folder: folder of the recording.
        first_step: first step to print; None: the first in the recording.
        last_step: last step to print; None: the last in the recording.
    """
    first = -math.inf if first_step is None else first_step
    last = math.inf if last_step is None else last_step
    coordinators, step = 0, -1
    same: Counter[bool | None] = Counter()
    for wall_ns, happening in replayed(folder, VERSION):
        match happening:
            case CoordinatorActs():
                coordinators += 1
            case Believed(belief, is_same):
                same[is_same] += 1
                step = belief.step
        if first <= step <= last:
            typer.echo(f"{_clock(wall_ns)} {_as_text(happening)}")
    typer.echo(_result(same, coordinators))
    return not same[False]


def _result(same: Counter[bool | None], coordinators: int) -> str:
    of = f"{same.total()} beliefs, {coordinators} coordinators"
    if same[False]:
        return f"{of}: {same[False]} beliefs differ from the recorded ones"
    if not same[True]:
        return f"{of}: no belief was recorded"
    return f"{of}: all as recorded, bit for bit"


def _clock(wall_ns: int) -> str:
    """Format a Unix time [ns] as date and time in UTC."""
    return datetime.fromtimestamp(wall_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S.%f")[:-3]


def _as_text(happening: Happening) -> str:
    match happening:
        case Happened(kind, about):
            return f"{kind}: {printable(about)}"
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
