"""`clustermcl replay`: recompute a flight recording, and print its events and beliefs."""

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from clustermcl.as_json import JsonObject, belief_object, dumped
from clustermcl.as_text import belief_line
from coordinator.recorder.records import Happened
from coordinator.recorder.replay import Believed, CoordinatorActs, Happening, replayed
from grid_maps.landmarks import landmarks_of_map
from protocol.errors import printable
from recordings.map_file import load_map


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


def print_replay(
    folder: Path,
    *,
    first_step: int | None,
    last_step: int | None,
    map_file: Path | None,
    as_json: bool,
) -> bool:
    """Recompute a whole recording; return whether every belief equals the recorded one.

    The events and beliefs of some steps are printed.

    Args:
        folder: folder of the recording.
        first_step: first step to print; None: the first in the recording.
        last_step: last step to print; None: the last in the recording.
        map_file: map of the recording; None: any map is accepted.
        as_json: print a JSON object per line instead of text.
    """
    first = -math.inf if first_step is None else first_step
    last = math.inf if last_step is None else last_step
    digest = None
    if map_file:
        digest = load_map(map_file).with_landmarks(landmarks_of_map(map_file)).digest
    comparison, step = Comparison(), -1
    for wall_ns, happening in replayed(folder, version("clustermcl"), digest):
        comparison.add(happening)
        if isinstance(happening, Believed):
            step = happening.belief.step
        if first <= step <= last:
            if as_json:
                _print(dumped({"wall_ns": wall_ns, **_as_object(step, happening)}))
            else:
                _print(f"{_clock(wall_ns)} {_as_text(happening)}")
    _print(dumped({"kind": "result", **vars(comparison)}) if as_json else comparison.text())
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


def _as_object(step: int, happening: Happening) -> JsonObject:
    match happening:
        case Happened(kind, about):
            return {"kind": kind, "step": step, "about": about}
        case CoordinatorActs(sender, term, after_step):
            return {
                "kind": "coordinator", "step": step, "name": sender, "term": term,
                "took_over_after_step": after_step,
            }  # fmt: skip
        case Believed(belief, same):
            fields = belief_object(belief)
            return {"kind": "belief", **fields, "term": belief.term, "as_recorded": same}


def _print(text: str) -> None:
    print(text)  # noqa: T201 - the command's answer
