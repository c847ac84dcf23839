"""What came of a soak: a table for people, an object for programs."""

import os
import platform
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version

from rich.console import Console
from rich.table import Table

from clustermcl.as_json import JsonObject, status_object
from protocol.answers import Status
from soak_test.availability import DoneFault
from soak_test.options import SoakOptions
from soak_test.resources import Resources
from soak_test.verdict import Break, Verdict

_KEPT = {True: "yes", False: "NO", None: "-"}
_BREAKS_SHOWN = 3
_BLAMED_NS = 30_000_000_000


class SoakResult:
    """Everything there is to tell."""

    def __init__(
        self,
        options: SoakOptions,
        start_ns: int,
        end_ns: int,
        faults: Sequence[DoneFault],
        verdicts: Sequence[Verdict],
        robots: dict[str, Sequence[Verdict]],
        resources: Resources,
        changes: dict[str, Sequence[Break]],
        statuses: dict[str, Status | None],
    ) -> None:
        self.options, self.start_ns, self.end_ns = options, start_ns, end_ns
        self.faults, self.verdicts, self.robots = faults, verdicts, robots
        self.resources, self.changes, self.statuses = resources, changes, statuses

    @property
    def broken(self) -> bool:
        """Whether a promise was not kept."""
        return any(verdict.kept is False for verdict in self.verdicts)

    def blamed(self, broken: Break) -> DoneFault | None:
        """The last fault before a promise was broken, if it was not long ago."""
        before = [fault for fault in self.faults if fault.at_ns <= broken.at_ns + 1_000_000_000]
        last = max(before, key=lambda fault: fault.at_ns, default=None)
        recent = last is not None and broken.at_ns - last.until_ns < _BLAMED_NS
        return last if recent else None

    def at_s(self, at_ns: int) -> float:
        """Time since the start, which was when all robots had found their places."""
        return (at_ns - self.start_ns) / 1e9


def print_result(result: SoakResult, console: Console) -> None:
    """The table of promises, and of each that was broken, when and after which fault."""
    minutes = result.at_s(result.end_ns) / 60
    table = Table(title=f"{minutes:.1f} minutes, {len(result.faults)} faults", box=None)
    for column in ("promise", "target", "measured", "kept"):
        table.add_column(column)
    for verdict in result.verdicts:
        table.add_row(
            verdict.promise,
            verdict.target,
            verdict.measured,
            _KEPT[verdict.kept],
            style="bold red" if verdict.kept is False else None,
        )
    console.print(table, markup=False)
    for verdict in result.verdicts:
        if verdict.kept is False:
            console.print(f"broken: {verdict.promise}", markup=False, soft_wrap=True)
            for broken in verdict.breaks[:_BREAKS_SHOWN]:
                console.print(f"  {_told(result, broken)}", markup=False, soft_wrap=True)
            if len(verdict.breaks) > _BREAKS_SHOWN:
                console.print(f"  and {len(verdict.breaks) - _BREAKS_SHOWN} more times")


def as_object(result: SoakResult) -> JsonObject:
    """All that was measured; times in seconds since the start."""
    resources = result.resources
    return {
        "version": version("clustermcl"),
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        "options": {name: _plain(value) for name, value in asdict(result.options).items()},
        "minutes": result.at_s(result.end_ns) / 60,
        "kept": not result.broken,
        "promises": [_verdict_object(result, verdict) for verdict in result.verdicts],
        "robots": {
            name: [_verdict_object(result, verdict) for verdict in verdicts]
            for name, verdicts in result.robots.items()
        },
        "statuses": {
            name: status_object(status) if status else None
            for name, status in result.statuses.items()
        },
        "changes_of_places": {
            name: [_break_object(result, change) for change in changes]
            for name, changes in result.changes.items()
        },
        "faults": [
            {
                "at_s": result.at_s(fault.at_ns),
                "kind": fault.kind.value,
                "robot": fault.robot,
                "target": fault.target,
                "lasts_s": (fault.until_ns - fault.at_ns) / 1e9,
            }
            for fault in result.faults
        ],
        "processes": {
            name: [
                {
                    "pid": pid,
                    "acts": acts,
                    "at_s": [time_s - result.start_ns / 1e9 for time_s in life.times_s],
                    "memory_mb": life.memory_mb,
                    "files": life.files,
                }
                for (pid, _, acts), life in lives.items()
            ]
            for name, lives in resources.lives.items()
        },
    }


def _verdict_object(result: SoakResult, verdict: Verdict) -> JsonObject:
    return {
        "promise": verdict.promise,
        "target": verdict.target,
        "measured": verdict.measured,
        "kept": verdict.kept,
        "figures": verdict.figures,
        "breaks": [_break_object(result, broken) for broken in verdict.breaks],
    }


def _break_object(result: SoakResult, broken: Break) -> JsonObject:
    fault = result.blamed(broken)
    return {
        "at_s": result.at_s(broken.at_ns) if broken.at_ns else None,
        "what": broken.what,
        "after": f"{fault.kind} at {result.at_s(fault.at_ns):.1f} s" if fault else None,
    }


def _told(result: SoakResult, broken: Break) -> str:
    if not broken.at_ns:
        return broken.what
    fault = result.blamed(broken)
    after = ""
    if fault is not None:
        whom = " ".join(filter(None, (fault.robot, fault.target)))
        after = f" (after {fault.kind} at {result.at_s(fault.at_ns):.1f} s: {whom})"
    return f"at {result.at_s(broken.at_ns):.1f} s: {broken.what}{after}"


def _plain(value: object) -> object:
    return value if isinstance(value, bool | int | float | str | None) else str(value)
