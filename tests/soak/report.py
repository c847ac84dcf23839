"""Output of a soak: progress on the terminal, a table, and JSON."""

import json
from dataclasses import asdict, dataclass, field
from typing import Any

from rich.console import Console
from rich.table import Table

from clustermcl.runtime.version import VERSION
from tests.soak.promises import Break, DoneFault, Verdict

_KEPT = {True: "yes", False: "NO", None: "-"}
_BREAKS_SHOWN = 3
_LINE_EVERY_S = 30.0


@dataclass
class SoakResult:
    options: Any
    """A dataclass."""
    faults: list[DoneFault]
    start_ns: int = 0
    """End of the first search."""
    end_ns: int = 0
    verdicts: list[Verdict] = field(default_factory=list)

    @property
    def is_broken(self) -> bool:
        return any(verdict.kept is False for verdict in self.verdicts)

    def at_s(self, at_ns: int) -> float:
        return (at_ns - self.start_ns) / 1e9


def print_result(result: SoakResult, console: Console) -> None:
    minutes = result.at_s(result.end_ns) / 60
    table = Table(title=f"{minutes:.1f} minutes, {len(result.faults)} faults", box=None)
    for column in ("promise", "target", "measured", "kept"):
        table.add_column(column)
    for verdict in result.verdicts:
        style = "bold red" if verdict.kept is False else None
        row = verdict.promise, verdict.target, verdict.measured, _KEPT[verdict.kept]
        table.add_row(*row, style=style)
    console.print(table, markup=False)
    for verdict in result.verdicts:
        for broken in verdict.breaks[:_BREAKS_SHOWN]:
            text = f"  {verdict.promise}: {_text(result, broken)}"
            console.print(text, markup=False, highlight=False, soft_wrap=True)
        if (more := len(verdict.breaks) - _BREAKS_SHOWN) > 0:
            console.print(f"  and {more} more times")


def as_json(result: SoakResult) -> str:
    what = {
        "version": VERSION,
        "options": asdict(result.options),
        "minutes": result.at_s(result.end_ns) / 60,
        "kept": not result.is_broken,
        "promises": [
            asdict(verdict) | {"breaks": [_text(result, one) for one in verdict.breaks]}
            for verdict in result.verdicts
        ],
        "faults": [
            {
                "kind": fault.kind.value,
                "at_s": result.at_s(fault.at_ns),
                "lasts_s": (fault.until_ns - fault.at_ns) / 1e9,
                "target": fault.target,
            }
            for fault in result.faults
        ],
    }
    return json.dumps(what, indent=1, default=str) + "\n"


class Progress:
    """Prints a line for each fault, and the present state every half minute."""

    def __init__(self, console: Console, minutes: float) -> None:
        self._console, self._minutes = console, minutes
        self._shown_s = -_LINE_EVERY_S

    def on_fault(self, fault: DoneFault, at_s: float) -> None:
        lasts_s = (fault.until_ns - fault.at_ns) / 1e9
        lasts = f" for {lasts_s:.1f} s" if lasts_s else ""
        self._print(f"{at_s:7.1f} s  {fault.kind}{lasts}: {fault.target} {fault.how}".rstrip())

    def on_turn(self, elapsed_s: float, summary: str, faults: int) -> None:
        if elapsed_s - self._shown_s < _LINE_EVERY_S:
            return
        self._shown_s = elapsed_s
        self._print(f"{elapsed_s / 60:.1f} of {self._minutes:g} min: {summary}, {faults} faults")

    def _print(self, text: str) -> None:
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)


def _text(result: SoakResult, broken: Break) -> str:
    return f"at {result.at_s(broken.at_ns):.1f} s: {broken.what}" if broken.at_ns else broken.what
