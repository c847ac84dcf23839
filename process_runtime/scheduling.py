"""Sets the scheduling policy of a worker."""

import logging
import os

_log = logging.getLogger(__name__)


def work_without_preempting() -> None:
    """Give this thread the policy SCHED_BATCH, so that it preempts no other thread when it wakes.

    A scan wakes all workers of a machine at once. With the default policy each interrupts
    another, whose data then leaves the cache. Threads that exist already keep their policy.
    """
    if not hasattr(os, "SCHED_BATCH"):
        return  # only Linux has it
    try:
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    except OSError as error:
        _log.debug("default scheduling policy kept: %s", error)
