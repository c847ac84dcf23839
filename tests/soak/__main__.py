"""`python -m tests.soak`: the command."""

import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from clustermcl.commands.options import Assignments, SettingsFile
from clustermcl.protocol.errors import ClusterMclError
from clustermcl.runtime.main import EXIT_ERROR
from clustermcl.runtime.output_files import check_output_file, write_output_file
from clustermcl.runtime.settings_file import load_settings
from clustermcl.runtime.stop import StoppedError, stop_on_signals
from clustermcl.runtime.version import VERSION
from tests.soak.promises import Break
from tests.soak.schedule import Kind, planned
from tests.soak.soak import SoakResult, run_soak

EXIT_BROKEN, EXIT_INTERRUPTED = 1, 130
_END_WITHIN_S = 60.0
_KEPT = {True: "kept", False: "BROKEN", None: "no data"}
_BREAKS_SHOWN, _BREAKS_KEPT = 3, 200
_FIRST_FAULT_S, _LAST_FAULT_S = 5.0, 15.0
"""Fault-free time after the start, and before the end for recovery from the last fault [s]."""


def soak(
    minutes: Annotated[float, typer.Option(min=0.1, help="After the first search.")] = 10.0,
    workers: Annotated[
        int, typer.Option(min=0, help="Worker processes, 10: two spare ones; 0: by need.")
    ] = 10,
    coordinators: Annotated[
        int, typer.Option(min=1, help="One leads, the others are standbys.")
    ] = 1,
    rate_hz: Annotated[float, typer.Option(min=0.1, help="Scans a second; each is a step.")] = 10.0,
    chaos: Annotated[bool, typer.Option("--chaos", help="Inject faults.")] = False,
    fault_every_s: Annotated[
        float, typer.Option(min=1.0, help="Mean time between two faults [s].")
    ] = 20.0,
    only: Annotated[
        list[Kind] | None, typer.Option(metavar="FAULT", help="With --chaos; may be repeated.")
    ] = None,
    world: Annotated[
        str, typer.Option(metavar="NAME", help="Simulated world; eight_rooms are all alike.")
    ] = "eight_rooms",
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of robot and faults.")] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write all figures there, as JSON.")
    ] = None,
    keep: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Keep logs and flight recordings there.")
    ] = None,
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Run the real processes on a simulated robot, inject faults, and check six promises.

    Exit code 1 if a promise was broken; 130 after Ctrl-C, which prints the present results.
    """
    if output is not None:
        check_output_file(output)
    given = [
        "bridge.source=zenoh", "bridge.gate_distance_m=0", "bridge.gate_turn_rad=0",
        "belief.max_clusters=8", f"worker.count={workers}",
    ]  # fmt: skip
    given += [f"seed={seed}"] if seed is not None else []
    settings = load_settings(settings_file, [*given, *(assignments or ())])
    stop = stop_on_signals(exit_after_s=_END_WITHIN_S)
    show = partial(print, flush=True)
    last_s = minutes * 60.0 - _LAST_FAULT_S if chaos else 0.0
    every_s, kinds = fault_every_s, only or ()
    faults = planned(
        settings.seed, first_s=_FIRST_FAULT_S, last_s=last_s, every_s=every_s, only=kinds
    )
    result = run_soak(
        *(settings, stop, show),
        minutes=minutes,
        world=world,
        rate_hz=rate_hz,
        coordinators=coordinators,
        faults=faults,
        keep=keep,
    )
    print_result(result, show)
    if output is not None:
        write_output_file(output, as_json(result))
    if result.is_broken:
        sys.exit(EXIT_BROKEN)
    stop.check()


def print_result(result: SoakResult, show: Callable[[str], None]) -> None:
    minutes = result.at_s(result.end_ns) / 60
    show(f"{minutes:.1f} minutes, {len(result.faults)} faults")
    for verdict in result.verdicts:
        figures = ", ".join(f"{name} {value:.4g}" for name, value in verdict.figures.items())
        show(f"{_KEPT[verdict.kept]:>8}: {verdict.promise}: {figures}")
        for broken in verdict.breaks[:_BREAKS_SHOWN]:
            show(f"          {_text(result, broken)}")
        if (more := len(verdict.breaks) - _BREAKS_SHOWN) > 0:
            show(f"          and {more} more times")


def as_json(result: SoakResult) -> str:
    what = {
        "version": VERSION,
        "minutes": result.at_s(result.end_ns) / 60,
        "kept": not result.is_broken,
        "promises": [
            asdict(verdict)
            | {"breaks": [_text(result, one) for one in verdict.breaks[:_BREAKS_KEPT]]}
            for verdict in result.verdicts
        ],
        "faults": [asdict(fault) | {"at_s": result.at_s(fault.at_ns)} for fault in result.faults],
    }
    return json.dumps(what, indent=1, default=str) + "\n"


def _text(result: SoakResult, broken: Break) -> str:
    return f"at {result.at_s(broken.at_ns):.1f} s: {broken.what}" if broken.at_ns else broken.what


if __name__ == "__main__":
    try:
        typer.run(soak)
    except StoppedError:
        sys.exit(EXIT_INTERRUPTED)
    except ClusterMclError as error:
        sys.stderr.write(f"tests.soak: {' '.join(str(error).split())}\n")
        sys.exit(EXIT_ERROR)
