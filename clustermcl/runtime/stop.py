"""The stop flag of a process, set by SIGINT, SIGTERM or the program itself."""

import faulthandler
import os
import select
import signal
import time
from collections.abc import Callable, Iterable
from types import FrameType
from typing import Protocol

_LOOK_EVERY_S = 1.0


class StoppedError(Exception):
    """The process was asked to stop while it waited; not a failure."""


class HasFile(Protocol):
    """A socket, or anything else with a file descriptor."""

    def fileno(self) -> int: ...


def wait_until_readable(files: Iterable[int | HasFile], timeout_s: float) -> None:
    """Wait until one of the files can be read, at most `timeout_s` [s]; signal handlers run."""
    poll = select.poll()
    for file in files:
        poll.register(file, select.POLLIN)
    poll.poll(timeout_s * 1000.0)


class StopFlag:
    """Set once, never cleared; every loop of a process checks it.

    No `threading.Event`, whose `set` takes a lock: a second signal during the first one's handler
    would deadlock on it. A pipe wakes those that wait.
    """

    def __init__(self) -> None:
        self._is_set = False
        self._reading, self._writing = os.pipe()
        self.on_look: Callable[[], None] = lambda: None
        """Called at each check, so in every turn of a running loop: the sign of life."""

    def __del__(self) -> None:
        os.close(self._reading)
        os.close(self._writing)

    def fileno(self) -> int:
        """Return a file that can be read once the flag is set."""
        return self._reading

    def set(self) -> None:
        """Request the stop; safe in any thread and signal handler, and more than once."""
        if not self._is_set:
            self._is_set = True
            os.write(self._writing, b"\0")

    def is_set(self) -> bool:
        self.on_look()
        return self._is_set

    def wait(self, timeout_s: float) -> bool:
        """Wait at most `timeout_s` [s] for the flag; return whether it is set."""
        deadline_s = time.monotonic() + timeout_s
        while not self._is_set:
            self.on_look()
            left_s = deadline_s - time.monotonic()
            if left_s <= 0.0:
                return False
            wait_until_readable([self], min(left_s, _LOOK_EVERY_S))
        return True

    def check(self) -> None:
        """Raise `StoppedError` if the flag is set."""
        self.on_look()
        if self._is_set:
            raise StoppedError


def stop_on_signals(*, exit_after_s: float = 4.5) -> StopFlag:
    """Create the flag of this process, which SIGINT and SIGTERM set.

    So does SIGHUP (a closed terminal), unless it is ignored as under ``nohup``.

    A process that has not ended `exit_after_s` after the first signal prints its stacks to
    standard error and exits with 1. The timer is a thread of faulthandler, which does not need
    the interpreter's lock.
    """
    stop = StopFlag()

    def on_signal(_number: int, _frame: FrameType | None) -> None:
        if not stop.is_set():
            faulthandler.dump_traceback_later(exit_after_s, exit=True)
        stop.set()

    signal.signal(signal.SIGINT, on_signal)
    signal.signal(signal.SIGTERM, on_signal)
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        signal.signal(signal.SIGHUP, on_signal)
    return stop
