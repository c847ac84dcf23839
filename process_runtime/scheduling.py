"""How the operating system shares cores among processes that wake up at the same moment."""

import logging
import os

_log = logging.getLogger(__name__)


def work_without_preempting() -> None:
    """Let this thread compute when its turn comes, but throw nobody off a core when it wakes.

    A scan wakes all workers of a machine at once. By the ordinary policy each that wakes
    interrupts another, whose data then leave the cache; in batches each does its step in one
    go. Threads that exist already, as those of Zenoh, keep their policy.
    """
    if not hasattr(os, "SCHED_BATCH"):
        return  # only Linux has it
    try:
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    except OSError as error:
        _log.debug("scheduled as usual: %s", error)
