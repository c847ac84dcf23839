"""`clustermcl replay`: recompute a flight recording, and print its events and beliefs."""

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import typer

from clustermcl.as_text import belief_line
from coordinator.recorder.records import Happened
from coordinator.recorder.replay import Believed, CoordinatorActs, Happening, replayed
from protocol.errors import printable


@dataclass
class Comparison:
    """Numbers of recomputed beliefs, and of those that differ from the recorded ones."""

    coordinators: int = 0
    """Number of times that a coordinator process began to lead."""
    beliefs: int = 0
    different: int = 0
    not_recorded: int = 0
    """Number of recomputed beliefs that the recording does not have."""

    def add(self, happening: Happening) -> None:
        match happening:
            case CoordinatorActs():
                self.coordinators += 1
            case Believed(same=same):
                self.beliefs += 1
                self.different += same is False
                self.not_recorded += same is None

    def text(self) -> str:
        of = f"{self.beliefs} beliefs, {self.coordinators} coordinators"
        if self.different:
            return f"{of}: {self.different} beliefs differ from the recorded ones"
        if self.beliefs == self.not_recorded:
            return f"{of}: no belief was recorded"
        return f"{of}: all as recorded, bit for bit"


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
    comparison, step = Comparison(), -1
    for wall_ns, happening in replayed(folder, version("clustermcl")):
        comparison.add(happening)
        if isinstance(happening, Believed):
            step = happening.belief.step
        if first <= step <= last:
            typer.echo(f"{_clock(wall_ns)} {_as_text(happening)}")
    typer.echo(comparison.text())
    return not comparison.different


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
