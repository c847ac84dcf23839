"""Children that do not outlive their parent, not even one that is killed with SIGKILL."""

import ctypes
import os
import signal
import sys

PARENT_VARIABLE = "CLUSTERMCL_PARENT_PID"
"""Environment variable by which a parent tells a child to die with it."""

_PR_SET_PDEATHSIG = 1


def die_with_parent(parent_pid: int) -> None:
    """Have the kernel kill this process when the thread that started it ends.

    The signal is SIGKILL: whoever is busy in compiled code or hangs goes too. A parent that
    died before the kernel was told is noticed by its changed process id.

    Only Linux offers this; elsewhere a killed parent leaves its children running.

    Args:
        parent_pid: process that shall be the parent; this process ends if it is not.
    """
    if sys.platform != "linux":
        return
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG) failed")
    if os.getppid() != parent_pid:
        os._exit(1)


def die_with_parent_if_asked() -> None:
    """Do so if the environment names a parent; this process's own children do not inherit it."""
    parent_pid = os.environ.pop(PARENT_VARIABLE, None)
    if parent_pid is not None:
        die_with_parent(int(parent_pid))
