"""Traces the latency of steps: each process writes time stamps to its own file.

Off unless `log.trace_folder` names a folder. A line holds step, event, sender of the message and
time [ns]. All processes of a machine share one monotonic clock, so that `benchmarks/latency.py`
can merge the files.
"""

import os
import time
from pathlib import Path

from protocol.errors import InputFileError
from protocol.message import Message

_KEPT_LINES = 64


class _TraceFile:
    """A file to which whole lines are appended in batches."""

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
    """Start this process's trace; an empty folder stops it.

    Raises:
        InputFileError: the folder cannot be created or written to.
    """
    global _file  # noqa: PLW0603 - one trace per process, like the log
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
    """Record an event of a message that belongs to a step; `at_ns` defaults to now."""
    if _file is None:
        return
    step = getattr(message, "step", None)
    if step is not None:
        stamp_ns = time.monotonic_ns() if at_ns is None else at_ns
        kind = type(message).__name__
        _file.write(f"{step} {kind}.{event} {message.sender} {stamp_ns}\n")
