"""Promises about the end: no process is left, nothing lies about, no process ended by itself."""

import logging
import os
import re
import shutil
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import psutil

from process_runtime.supervisor import ChildExit
from soak_test.availability import DoneFault
from soak_test.schedule import Kind
from soak_test.verdict import Break, Verdict

_log = logging.getLogger(__name__)

STOP_WITHIN_S = 3.0
_KILLED_NS = 10_000_000_000
_TROUBLE = re.compile(r"Traceback|a bug ended|panicked at|Fatal Python error")
_KILLS = {
    Kind.ALL_WORKERS_KILLED, Kind.COORDINATOR_KILLED, Kind.BRIDGE_KILLED, Kind.ROUTER_KILLED,
}  # fmt: skip


@contextmanager
def temporary_files_in(folder: Path) -> Iterator[Path]:
    """Have all processes that are started meanwhile put their temporary files into a folder.

    What they leave behind is then seen, and is not mixed up with other programs' files.
    """
    left, before = folder / "left", os.environ.get("TMPDIR")
    left.mkdir()
    os.environ["TMPDIR"] = str(left)
    try:
        yield left
    finally:
        if before is None:
            del os.environ["TMPDIR"]
        else:
            os.environ["TMPDIR"] = before


def left_files(left: Path) -> list[str]:
    """Temporary files that nobody removed."""
    return sorted(str(path.relative_to(left)) for path in left.rglob("*") if path.is_file())


def kept_logs(logs: Iterable[Path], folder: Path) -> None:
    """Copy logs to where they are not removed; what cannot be copied is told, and no more lost."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for log in logs:
            shutil.copy(log, folder)
    except OSError as error:
        _log.warning("the logs cannot be kept: %s", error)


def processes_left(known: Iterable[psutil.Process], folder: Path, wait_s: float = 2.0) -> list[str]:
    """Processes of the fleet that still run, or have ended and were not reaped.

    Args:
        known: all that were ever seen.
        folder: theirs; a process that nobody saw has it on its command line.
        wait_s: how long they may take to go.
    """
    deadline_s = time.monotonic() + wait_s
    while True:
        left = [process for process in known if process.is_running()]
        found = {process.pid for process in left}
        left += [
            process
            for process in psutil.process_iter(["cmdline"])
            if process.pid not in found and str(folder) in " ".join(process.info["cmdline"] or ())
        ]
        if not left or time.monotonic() > deadline_s:
            return [_described(process) for process in left]
        time.sleep(0.05)


def _described(process: psutil.Process) -> str:
    try:
        return f"{process.pid} {process.name()} ({process.status()})"
    except psutil.NoSuchProcess:
        return f"{process.pid}"


def ended_verdict(
    processes: Sequence[str], zombies: Sequence[str], files: Sequence[str], stop_s: float
) -> Verdict:
    """On what is left at the end, and how long that took."""
    breaks = [Break(0, f"process {one}") for one in processes]
    breaks += [Break(0, f"zombie {one}") for one in zombies]
    breaks += [Break(0, f"file {one}") for one in files]
    if stop_s > STOP_WITHIN_S:
        breaks.append(Break(0, f"the processes took {stop_s:.1f} s to end"))
    return Verdict(
        promise="in the end no process, zombie or file is left",
        target=f"none, {STOP_WITHIN_S:g} s after the stop",
        measured=f"{len(processes)} processes, {len(zombies)} zombies, {len(files)} files; "
        f"{stop_s:.1f} s",
        kept=not breaks,
        breaks=tuple(breaks),
        figures={"processes": len(processes), "files": len(files), "stop_s": stop_s},
    )


def exits_verdict(
    exits: Sequence[tuple[int, ChildExit]], faults: Sequence[DoneFault], logs: Sequence[Path]
) -> Verdict:
    """On processes that ended though nobody killed them, and on tracebacks in their logs."""
    breaks = [
        Break(at_ns, f"{ended.name} ended with code {ended.code}: {ended.last_words}")
        for at_ns, ended in exits
        if not any(_explains(fault, at_ns, ended.name) for fault in faults)
    ]
    troubled = [log.name for log in logs if _TROUBLE.search(log.read_text(errors="replace"))]
    breaks += [Break(0, f"{name} has a traceback") for name in troubled]
    return Verdict(
        promise="no process ends unless it is killed",
        target="none, no traceback",
        measured=f"{len(breaks) - len(troubled)} of {len(exits)} ends; "
        f"{len(troubled)} logs with a traceback",
        kept=not breaks,
        breaks=tuple(breaks),
        figures={"ends": len(exits), "unexplained": len(breaks) - len(troubled)},
    )


def _explains(fault: DoneFault, at_ns: int, name: str) -> bool:
    robot, _, own = name.rpartition("/")
    same = fault.kind in _KILLS and (fault.robot, fault.target) == (robot, own)
    return same and fault.at_ns <= at_ns <= fault.at_ns + _KILLED_NS
