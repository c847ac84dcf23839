"""Where the time of a step goes: stamps that every process writes down by itself.

Off unless `log.trace_folder` names a folder. Then each process appends lines to a file of its
own there: step, event, sender of the message, time in nanoseconds. All processes of a machine
share one monotonic clock, so the files can be put together (`benchmarks/latency.py`).
"""

import os
import time
from pathlib import Path

from protocol.errors import InputFileError
from protocol.message import Message

_KEPT_LINES = 64


class _TraceFile:
    """A file that is appended to, some lines at a time, in whole lines."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        self._lines: list[str] = []

    def write(self, line: str) -> None:
        self._lines.append(line)
        if len(self._lines) >= _KEPT_LINES:
            os.write(self._file, "".join(self._lines).encode())
            self._lines.clear()


_file: _TraceFile | None = None


def start_trace(folder: str, process: str) -> None:
    """Write stamps from now on, if a folder is named; as with the log, one for the process.

    Raises:
        InputFileError: the folder cannot be made or written to.
    """
    global _file  # noqa: PLW0603 - a process has one trace, as it has one log
    if not folder:
        _file = None
        return
    path = Path(folder).expanduser()
    try:
        path.mkdir(parents=True, exist_ok=True)
        _file = _TraceFile(path / f"{process}-{os.getpid()}.trace")
    except OSError as error:
        raise InputFileError(path, f"log.trace_folder: {error.strerror}") from error


def mark(event: str, message: Message, at_ns: int | None = None) -> None:
    """Write down that something has just happened to a message of a step, or when it did."""
    if _file is None:
        return
    step = getattr(message, "step", None)
    if step is not None:
        stamp_ns = time.monotonic_ns() if at_ns is None else at_ns
        kind = type(message).__name__
        _file.write(f"{step} {kind}.{event} {message.sender} {stamp_ns}\n")
