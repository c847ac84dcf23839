"""When to stop: one flag a process, set by SIGINT and SIGTERM or by the program itself."""

import faulthandler
import signal
import time
from collections.abc import Callable
from types import FrameType

_POLL_S = 0.05


class StoppedError(Exception):
    """The process was asked to stop while it waited for something; not a failure."""


class StopFlag:
    """Set once, never unset; every loop of a process looks at it.

    Setting it only appends to a list. `threading.Event.set` takes a lock, and a second
    signal that arrives while the first one's handler holds it would wait for ever.
    """

    def __init__(self) -> None:
        self._requests: list[int] = []
        self.on_look: Callable[[], None] = lambda: None
        """Called by each look at the flag: a loop that goes on looks at it in every turn."""

    def set(self, reason: int = 0) -> None:
        """Ask for the stop; from any thread or signal handler, as often as one likes."""
        self._requests.append(reason)

    def is_set(self) -> bool:
        """Tell whether the process shall stop."""
        self.on_look()
        return bool(self._requests)

    @property
    def reason(self) -> int:
        """The signal that asked first; 0 while nobody has, or when the program itself did."""
        return self._requests[0] if self._requests else 0

    def wait(self, timeout_s: float) -> bool:
        """Wait until the flag is set, at most so long; return whether it is set.

        A handler runs in the main thread between two naps, so it is seen within 0.05 s.
        """
        deadline_s = time.monotonic() + timeout_s
        while not self._requests:
            self.on_look()
            left_s = deadline_s - time.monotonic()
            if left_s <= 0.0:
                return False
            time.sleep(min(left_s, _POLL_S))
        return True

    @staticmethod
    def take_time() -> None:
        """Have nobody watch any more whether the process ends soon: what hangs is closed."""
        faulthandler.cancel_dump_traceback_later()

    def check(self) -> None:
        """Raise `StoppedError` when the flag is set: leaves nested waiting in one go."""
        self.on_look()
        if self._requests:
            raise StoppedError


def stop_on_signals(*, exit_after_s: float = 1.9) -> StopFlag:
    """Make the flag of this process: SIGINT and SIGTERM set it, a second one does no harm.

    So does SIGHUP, a terminal that closes, unless it is ignored, as under ``nohup``.

    A process that has not ended `exit_after_s` after the first signal, because something
    hangs while closing, writes where it hangs to standard error and exits with 1. The watch
    is a thread of faulthandler's, which needs neither the interpreter's lock nor its help.
    """
    stop = StopFlag()

    def on_signal(number: int, _frame: FrameType | None) -> None:
        if not stop.is_set():
            faulthandler.dump_traceback_later(exit_after_s, exit=True)
        stop.set(number)

    signal.signal(signal.SIGINT, on_signal)
    signal.signal(signal.SIGTERM, on_signal)
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        signal.signal(signal.SIGHUP, on_signal)
    return stop
