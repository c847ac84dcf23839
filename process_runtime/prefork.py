"""Forks identical child processes that share the memory of heavy modules.

Importing numba takes a process one second and 150 MB; twelve processes on two cores take ten
seconds. Here the parent imports and compiles once, and its children start at once.
"""

import gc
import logging
import mmap
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

from process_runtime.backoff import Backoff
from process_runtime.logs import configure_logging
from process_runtime.main import outermost
from process_runtime.parent import die_with_parent
from process_runtime.stop import StopFlag, stop_on_signals
from process_runtime.watchdog import HangDetector

_log = logging.getLogger(__name__)

_SIGNALS = {signal.SIGINT, signal.SIGTERM}
_TERMINATE_WITHIN_S = 1.2
_POLL_S = 0.05
HUNG_AFTER_S = 120.0
"""A worker may wait 30 s for a large map and then compute its likelihood field."""


def use_one_thread_for_arithmetic() -> None:
    """Keep OpenBLAS and OpenMP from starting threads; call before the first import of numpy.

    A fork copies only the calling thread: a lock held by another thread stays locked in the
    child. Twelve workers on two cores need no further threads.
    """
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[variable] = "1"


def run_forked(
    count: int,
    child_main: Callable[[int, StopFlag], None],
    stop: StopFlag,
    *,
    name: str,
    hung_after_s: float = HUNG_AFTER_S,
) -> None:
    """Keep `count` forked children alive until `stop` is set, then end them.

    A child that ends, or hangs and no longer checks its stop flag, is replaced after a back-off
    by one with the same index. Children die with this process, even by kill -9.

    Args:
        count: number of children.
        child_main: the work of one child, given its index from 0 and its own stop flag. It opens
            its own Zenoh session; the parent must never have opened one.
        stop: stop flag of this process.
        name: name of this process; children are called ``name-index`` in the log.
        hung_after_s: a child that does not check its stop flag for this time is killed [s].

        Raises:
            RuntimeError: this process has threads, so a fork is not safe.
    """
    if stop.is_set():
        return  # the exit timer is a thread, see `stop_on_signals`
    _check_single_threaded()
    gc.collect()
    gc.freeze()  # else the collector writes to, and so copies, every shared page
    looked_s = memoryview(mmap.mmap(-1, 8 * count)).cast("d")  # shared with the children
    slots = [_Slot(index, f"{name}-{index}", looked_s, hung_after_s) for index in range(count)]
    try:
        while not stop.wait(_POLL_S):
            for slot in slots:
                slot.keep_alive(child_main, time.monotonic())
    finally:
        _end(slots)


@dataclass
class _Slot:
    """One child index: the present process and when to start the next."""

    index: int
    name: str
    looked_s: "memoryview[float]"
    """When each child last checked its stop flag, by `time.monotonic` [s]."""
    hung_after_s: float
    detector: HangDetector = field(init=False)
    pid: int | None = None
    backoff: Backoff = field(default_factory=Backoff)
    started_at_s: float = 0.0
    start_at_s: float = 0.0

    def keep_alive(self, child_main: Callable[[int, StopFlag], None], now_s: float) -> None:
        if self.pid is not None and (code := self.reap(os.WNOHANG)) is not None:
            wait_s = self.backoff.after_death(now_s - self.started_at_s)
            self.start_at_s = now_s + wait_s
            _log.warning("%s ended with code %d; restarting in %.1f s", self.name, code, wait_s)
        if self.pid is None and now_s >= self.start_at_s:
            self.started_at_s = self.looked_s[self.index] = now_s
            self.detector = HangDetector(self.hung_after_s)
            self.pid = _fork(self, child_main)
        elif self.pid is not None:
            self.detector.heard(self.looked_s[self.index])
            if self.detector.hangs(now_s):
                _log.warning("%s hung for %g s: killed", self.name, self.hung_after_s)
                self.looked_s[self.index] = now_s
                self.send(signal.SIGKILL)

    def look(self) -> None:
        """Give a sign of life; called in the child."""
        self.looked_s[self.index] = time.monotonic()

    def reap(self, options: int) -> int | None:
        """Exit code (-9 for SIGKILL) if the child has ended, None if it runs."""
        if self.pid is None:
            return None
        pid, status = os.waitpid(self.pid, options)
        if pid == 0:
            return None
        self.pid = None
        return os.waitstatus_to_exitcode(status)

    def send(self, number: signal.Signals) -> None:
        if self.pid is not None:
            os.kill(self.pid, number)  # not reaped yet, so the id is not reused


def _fork(slot: _Slot, child_main: Callable[[int, StopFlag], None]) -> int:
    """Return the child's process id; in the child, run `child_main` and exit."""
    parent_pid = os.getpid()
    sys.stdout.flush()
    sys.stderr.flush()
    # Block signals until the child has installed its own handlers.
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    pid = os.fork()
    if pid == 0:
        _run_child(slot, child_main, parent_pid)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
    return pid


def _run_child(
    slot: _Slot, child_main: Callable[[int, StopFlag], None], parent_pid: int
) -> NoReturn:
    code, name = 1, slot.name
    try:
        die_with_parent(parent_pid)
        _be_called(name)
        stop = stop_on_signals()
        stop.on_look = slot.look
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
        configure_logging(name, logging.getLevelName(logging.getLogger().level))
        code = outermost(name, lambda: child_main(slot.index, stop))
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)  # the exit handlers and open files are the parent's


def _be_called(name: str) -> None:
    """Set the name that `ps` and `top` show; all children share one command line."""
    comm = Path("/proc/self/comm")
    if comm.exists():
        comm.write_text(name, "utf-8")  # the kernel keeps 15 bytes


def _end(slots: list[_Slot]) -> None:
    for slot in slots:
        slot.send(signal.SIGTERM)
    deadline_s = time.monotonic() + _TERMINATE_WITHIN_S
    while any(slot.pid is not None for slot in slots) and time.monotonic() < deadline_s:
        for slot in slots:
            slot.reap(os.WNOHANG)
        time.sleep(_POLL_S / 5)
    for slot in slots:
        slot.send(signal.SIGKILL)
        slot.reap(0)


def _check_single_threaded() -> None:
    tasks = Path("/proc/self/task")
    threads = sum(1 for _ in tasks.iterdir()) if tasks.is_dir() else threading.active_count()
    if threads > 1:
        raise RuntimeError(
            f"{threads} threads run at the fork: fork before opening a Zenoh session, "
            "and call use_one_thread_for_arithmetic() before importing numpy"
        )
