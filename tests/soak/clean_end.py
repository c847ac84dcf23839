"""Promise: a clean end. No process exits by itself, and none leaves files or processes."""

import re
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from clustermcl.runtime.supervisor import ChildExit
from tests.soak.promises import Break, Verdict
from tests.soak.schedule import RULES, DoneFault

STOP_WITHIN_S = 3.0
_KILLED_NS = 10_000_000_000
_TROUBLE = re.compile(r"Traceback|a bug ended|panicked at|Fatal Python error")


@contextmanager
def temporary_files_in(folder: Path) -> Iterator[Path]:
    """Set the folder for temporary files of all processes started within this context.

    Files left there come from these processes alone.
    """
    left = folder / "left"
    left.mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", str(left))
        yield left


def processes_left(known: Iterable[psutil.Process], folder: Path, wait_s: float = 2.0) -> list[str]:
    """Return the ids of processes that still run, or have ended but were not reaped."""
    deadline_s = time.monotonic() + wait_s
    while True:
        left = {process for process in known if process.is_running()}
        left |= {
            process
            for process in psutil.process_iter(["cmdline"])
            if str(folder) in " ".join(process.info["cmdline"] or ())
        }
        if not left or time.monotonic() > deadline_s:
            return [str(process.pid) for process in left]
        time.sleep(0.05)


def clean_end_verdict(
    exits: Sequence[tuple[int, ChildExit]],
    faults: Sequence[DoneFault],
    logs: Sequence[Path],
    processes: Sequence[str],
    files: Path,
    stop_s: float,
) -> Verdict:
    left = sorted(str(path.relative_to(files)) for path in files.rglob("*") if path.is_file())
    breaks = [
        Break(at_ns, f"{ended.name} ended with code {ended.code}: {ended.last_words}")
        for at_ns, ended in exits
        if not any(_explains(fault, at_ns, ended.name) for fault in faults)
    ]
    troubled = [log.name for log in logs if _TROUBLE.search(log.read_text(errors="replace"))]
    breaks += [Break(0, f"{name} has a traceback") for name in troubled]
    breaks += [Break(0, f"process {one} is left") for one in processes]
    breaks += [Break(0, f"file {one} is left") for one in left]
    if stop_s > STOP_WITHIN_S:
        breaks.append(Break(0, f"the processes took {stop_s:.1f} s to end"))
    return Verdict(
        promise="a clean end",
        kept=not breaks,
        breaks=tuple(breaks),
        figures={"exits": len(exits), "processes": len(processes), "stop_s": stop_s},
    )


def _explains(fault: DoneFault, at_ns: int, name: str) -> bool:
    is_hit = RULES[fault.kind].does == "kill" and fault.target == name.rpartition("/")[2]
    return is_hit and fault.at_ns <= at_ns <= fault.at_ns + _KILLED_NS
