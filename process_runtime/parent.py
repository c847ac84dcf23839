"""Ends child processes with their parent, even one killed with SIGKILL."""

import ctypes
import os
import signal
import sys

PARENT_VARIABLE = "CLUSTERMCL_PARENT_PID"
"""Environment variable with the process id that `die_with_parent_if_asked` uses."""

_PR_SET_PDEATHSIG = 1


def die_with_parent(parent_pid: int) -> None:
    """Have the kernel send SIGKILL to this process when the thread that started it ends.

    SIGKILL also ends a process that is in compiled code or hangs. Linux only; elsewhere the
    children of a killed parent keep running.

    Args:
        parent_pid: the expected parent; if it has died already, this process exits.
    """
    if sys.platform != "linux":
        return
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG) failed")
    if os.getppid() != parent_pid:
        os._exit(1)


def die_with_parent_if_asked() -> None:
    """Call `die_with_parent` if the environment names a parent, and remove the variable."""
    parent_pid = os.environ.pop(PARENT_VARIABLE, None)
    if parent_pid is not None:
        die_with_parent(int(parent_pid))
