"""Where the processor time of a running stack goes: by process, by thread, and how often each woke.

The kernel counts it (Linux): ``/proc/PID/task/TID/schedstat``, to the nanosecond.
"""

from collections import defaultdict
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil


@dataclass(frozen=True)
class Spent:
    """CPU time of one or several threads until now."""

    cpu_ns: int = 0
    turns: int = 0
    """How often it was given a core: once for each time that it woke, or was interrupted."""

    def __add__(self, other: "Spent") -> "Spent":
        return Spent(self.cpu_ns + other.cpu_ns, self.turns + other.turns)

    def __sub__(self, other: "Spent") -> "Spent":
        return Spent(self.cpu_ns - other.cpu_ns, self.turns - other.turns)


ByThread = Mapping[tuple[str, int, str, int], Spent]
"""Part of the stack, process, kind of thread, thread."""


def spent_by_thread() -> ByThread:
    """Of all children of this process, and theirs."""
    spent: dict[tuple[str, int, str, int], Spent] = {}
    for process in psutil.Process().children(recursive=True):
        with suppress(psutil.NoSuchProcess):
            words = process.cmdline()
            part = words[words.index("-m") + 1] if "-m" in words[:-1] else ""
            for thread in process.threads():
                spent |= _spent_by(part, process.pid, thread.id)
    return spent


def _spent_by(part: str, pid: int, thread: int) -> ByThread:
    """One thread's; nothing if it has just ended."""
    task = Path(f"/proc/{pid}/task/{thread}")
    with suppress(OSError):
        cpu_ns, _, turns = (task / "schedstat").read_text().split()
        kind = _kind(pid, thread, (task / "comm").read_text().strip())
        return {(part, pid, kind, thread): Spent(int(cpu_ns), int(turns))}
    return {}


def _kind(pid: int, thread: int, name: str) -> str:
    """Zenoh's threads have names: rx-0 receives, tx-0 sends; others call back, or write files."""
    if thread == pid:
        return "main"
    kind, _, number = name.rpartition("-")
    is_zenohs = kind in ("rx", "tx", "net", "app", "acc") and number.isdigit()
    return f"zenoh {kind}" if is_zenohs else "others"


def in_between(before: ByThread, after: ByThread) -> ByThread:
    """CPU time spent in between by threads that existed before."""
    return {thread: spent - before[thread] for thread, spent in after.items() if thread in before}


def processes_table(spent: ByThread, steps: float) -> str:
    """Milliseconds and turns of a step, by part and kind of thread."""
    parts: dict[str, dict[str, Spent]] = defaultdict(lambda: defaultdict(Spent))
    processes: dict[str, set[int]] = defaultdict(set)
    for (part, pid, kind, _), each in spent.items():
        processes[part].add(pid)
        for name in ("all", kind):
            parts[part][name] += each
    lines = ["| part, thread | CPU ms a step | turns a step |", "| --- | --- | --- |"]
    for part, kinds in sorted(parts.items(), key=lambda item: -item[1]["all"].cpu_ns):
        for kind, each in sorted(kinds.items(), key=lambda item: -item[1].cpu_ns):
            whole = f"**{part}**, {len(processes[part])} processes"
            name = whole if kind == "all" else f"{part}: {kind}"
            lines.append(f"| {name} | {each.cpu_ns / 1e6 / steps:.2f} | {each.turns / steps:.1f} |")
    return "\n".join(lines)
