"""What a process has from the one that started it: its end, and its standard files."""

import ctypes
import os
import signal
import sys

PARENT_VARIABLE = "CLUSTERMCL_PARENT_PID"
"""Environment variable with the process id that `die_with_parent_if_asked` uses."""

_PR_SET_PDEATHSIG = 1


def die_with_parent(parent_pid: int) -> None:
    """Have the kernel send SIGKILL to this process when the thread that started it ends.

    SIGKILL also ends a process that is in compiled code or hangs. If the parent has another id, it
    has died: this process exits.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG) failed")
    if os.getppid() != parent_pid:
        os._exit(1)


def open_standard_files() -> None:
    """Open the null device for each closed standard file, as of ``clustermcl up 2>&-``.

    Else Python has no such file, and the next file that is opened takes its number.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest free number
            setattr(sys, name, os.fdopen(number, "w" if number else "r", encoding="utf-8"))


def die_with_parent_if_asked() -> None:
    """Call `die_with_parent` if the environment names a parent, and remove the variable."""
    parent_pid = os.environ.pop(PARENT_VARIABLE, None)
    if parent_pid is not None:
        die_with_parent(int(parent_pid))
