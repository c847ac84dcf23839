"""Starts child processes by exec or fork, restarts dead and hung ones, and ends them all.

A parent that forks its children imports once, and they start at once and share its memory.
"""

import gc
import itertools
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NoReturn, TypeAlias

from clustermcl.runtime.logs import configure_logging
from clustermcl.runtime.main import EXIT_ERROR, outermost
from clustermcl.runtime.parent import PARENT_VARIABLE, die_with_parent
from clustermcl.runtime.stop import StopFlag, stop_on_signals, wait_until_readable
from clustermcl.runtime.watchdog import Listener, SignsOfLife

_log = logging.getLogger(__name__)

_SIGNALS = {signal.SIGINT, signal.SIGTERM}
_TERMINATE_WITHIN_S = 1.5
_TERMINATE_FORKS_WITHIN_S = 1.2
"""Less, because their parent may itself be a supervisor's child."""
_GIVEN_UP_BEFORE_S = 10.0
_POLL_S, _LONGEST_POLL_S = 0.05, 1.0
HUNG_AFTER_S = 13.0
"""A turn of a process's loop takes less than a second. A hung one answers again within 15 s."""
FORK_HUNG_AFTER_S = 120.0
"""A worker may wait 30 s for a large map and then compute its likelihood field."""
_LAST_WORDS_BYTES = 4096
_FIRST_WAIT_S, _LONGEST_WAIT_S, _SETTLED_S = 0.1, 10.0, 10.0
_STANDARD_ERROR = 2


def python_module(module: str, *arguments: str) -> list[str]:
    """Return the command of one of our modules; ``-I`` ignores modules in the current folder."""
    return [sys.executable, "-I", "-m", module, *arguments]


class Backoff:
    """Delays between restarts: each twice the one before; from the start after a long run."""

    def __init__(self) -> None:
        self._next_s = _FIRST_WAIT_S

    def after_death(self, lived_s: float) -> float:
        """Return the delay before the next start [s], for a process that ran `lived_s`."""
        wait_s = self._next_s if lived_s < _SETTLED_S else _FIRST_WAIT_S
        self._next_s = min(2.0 * wait_s, _LONGEST_WAIT_S)
        return wait_s


ReportJobs: TypeAlias = Callable[[int], None]
"""Reports to the supervisor how many jobs a child has."""
ForkedWork: TypeAlias = Callable[[StopFlag, ReportJobs], None]
"""Work of a forked child, called with its own stop flag."""


@dataclass(frozen=True)
class ChildSpec:
    """A process to keep alive."""

    name: str
    command: Sequence[str] = ()
    """Program and arguments; see `python_module`."""
    log: Path | None = None
    """File for its output (appended); None: this process's standard error."""
    fork: ForkedWork | None = None
    """In place of a command."""


@dataclass(frozen=True)
class ChildExit:
    """A child has ended."""

    name: str
    code: int
    """Exit code; negative for a signal, such as -9 for SIGKILL."""
    restart_in_s: float | None
    """None: it is not restarted, because it has refused to start."""
    last_words: str
    """Last line of its log file, the error if the code is 2; empty without a log file."""


class Supervisor:
    """Child processes that are restarted and never outlive this process.

    The kernel ends a child when the *thread* that started it ends: call `add` and `poll` from
    one long-lived thread. A command that rejects its settings (exit code 2 soon after its start)
    is not restarted. A child without a sign of life for `hung_after_s` is killed and restarted.
    """

    def __init__(self, *, hung_after_s: float = HUNG_AFTER_S) -> None:
        self._hung_after_s = hung_after_s
        self._children: list[_Child] = []
        self._leaving: list[_Child] = []

    def add(self, spec: ChildSpec) -> None:
        """Start a child, whose name no other one has, and keep it alive."""
        child = _Child(spec, self._hung_after_s)
        self._children.append(child)
        child.start()

    def poll(self, now_s: float) -> list[ChildExit]:
        """Restart children that are due; return those that ended since the last call."""
        self._leaving = [child for child in self._leaving if not child.has_left(now_s)]
        polled = [child.polled(now_s) for child in self._children]
        return [ended for ended in polled if ended is not None]

    def wait(self, stop: StopFlag) -> bool:
        """Wait until `poll` may have something to do; return whether the stop flag is set."""
        children = [*self._children, *self._leaving]
        files = [stop, *(file for child in children for file in (child.end, child.listener))]
        # A `Listener` expects several calls in the time after which a child hangs.
        longest_s = min(_LONGEST_POLL_S, self._hung_after_s / 8)
        is_settled = not self._leaving and all(child.end is not None for child in children)
        wait_until_readable(filter(None, files), longest_s if is_settled else _POLL_S)
        return stop.is_set()

    def jobs(self) -> dict[str, int | None]:
        """Return the number of jobs of each child; None: it has not reported any."""
        return {
            child.spec.name: child.listener.jobs if child.listener else None
            for child in self._children
        }

    def remove(self, name: str) -> None:
        """Ask a child to end, and do not restart it; `poll` kills it if it does not end soon."""
        (child,) = (each for each in self._children if each.spec.name == name)
        self._children.remove(child)
        self._leaving.append(child)
        child.leave(time.monotonic() + _TERMINATE_FORKS_WITHIN_S)

    def pids(self) -> dict[str, int]:
        """Return the process ids of the running children by name, removed ones included."""
        every = [*self._children, *self._leaving]
        return {child.spec.name: child.process.pid for child in every if child.process}

    def stop(self, within_s: float = _TERMINATE_WITHIN_S) -> None:
        """End all children: SIGTERM, then SIGKILL after `within_s` [s]."""
        children, self._children = [*self._children, *self._leaving], []
        for child in children:
            child.leave(time.monotonic() + within_s)
        while children := [child for child in children if not child.has_left(time.monotonic())]:
            time.sleep(_POLL_S / 5)


class _Fork:
    """A forked child process, with the methods of `Popen` that the supervisor uses."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._code: int | None = None

    def poll(self) -> int | None:
        if self._code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self._code = os.waitstatus_to_exitcode(status) if pid else None
        return self._code

    def send_signal(self, sig: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, sig)  # not reaped yet, so the id is not reused


_Process: TypeAlias = subprocess.Popen[bytes] | _Fork


class _Child:
    """One child: the present process and when to start the next."""

    def __init__(self, spec: ChildSpec, hung_after_s: float) -> None:
        self.spec, self._hung_after_s = spec, hung_after_s
        self.process: _Process | None = None
        self._backoff = Backoff()
        self._started_at_s = 0.0
        self._start_at_s: float | None = None
        self._leaves_until_s = 0.0
        self.listener: Listener | None = None
        self.end: int | None = None
        """A file that can be read once the process has ended."""

    def start(self) -> None:
        self._start_at_s, self._started_at_s = None, time.monotonic()
        self.listener = Listener(self._hung_after_s)
        started = _executed if self.spec.fork is None else _forked
        self.process = started(self.spec, self.listener.variables())
        with suppress(OSError):  # an old kernel, or a container that forbids it
            self.end = os.pidfd_open(self.process.pid)

    def polled(self, now_s: float) -> ChildExit | None:
        """Start the process if it is due, kill it if it hangs, and return its exit once."""
        if self._start_at_s is not None and now_s >= self._start_at_s:
            self.start()
        if self.process is None:
            return None
        if self.listener is not None and self.listener.is_hung(now_s):
            _log.warning("%s hung for %g s: killed", self.spec.name, self._hung_after_s)
            self._stop_listening()
            self.process.send_signal(signal.SIGKILL)
        if (code := self.process.poll()) is None:
            return None
        self.forget()
        lived_s = now_s - self._started_at_s
        wait_s: float | None = None
        is_young_command = self.spec.fork is None and lived_s < _GIVEN_UP_BEFORE_S
        if not (code == EXIT_ERROR and is_young_command):  # it has not refused to start
            wait_s = self._backoff.after_death(lived_s)
            self._start_at_s = now_s + wait_s
        return ChildExit(self.spec.name, code, wait_s, self._last_log_lines())

    def leave(self, until_s: float) -> None:
        """Ask the process to end; `has_left` kills it after this time of `time.monotonic` [s]."""
        self._leaves_until_s = until_s
        self._stop_listening()  # else its last signs, which nobody reads, would end each wait
        if self.process is not None:
            self.process.send_signal(signal.SIGTERM)

    def has_left(self, now_s: float) -> bool:
        """Return whether the process has ended; kill it if its time is over."""
        if self.process is not None and self.process.poll() is None:
            if now_s >= self._leaves_until_s:
                self.process.send_signal(signal.SIGKILL)
            return False
        self.forget()
        return True

    def forget(self) -> None:
        self.process, self._start_at_s = None, None
        if self.end is not None:
            os.close(self.end)
            self.end = None
        self._stop_listening()

    def _stop_listening(self) -> None:
        if self.listener is not None:
            self.listener.close()
        self.listener = None

    def _last_log_lines(self) -> str:
        if self.spec.log is None:
            return ""
        with self.spec.log.open("rb") as log:
            log.seek(max(0, self.spec.log.stat().st_size - _LAST_WORDS_BYTES))
            lines = log.read().decode(errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "")


def _executed(spec: ChildSpec, variables: dict[str, str]) -> _Process:
    with ExitStack() as stack:
        log = stack.enter_context(spec.log.open("ab")) if spec.log is not None else None
        # Its own process group: Ctrl-C reaches only this process, which ends the others.
        return subprocess.Popen(
            spec.command,
            stdin=subprocess.DEVNULL,
            # This process's standard output may be one JSON object.
            stdout=log or _STANDARD_ERROR,
            stderr=log or _STANDARD_ERROR,
            env={**os.environ, PARENT_VARIABLE: str(os.getpid()), **variables},
            process_group=0,
        )


def _forked(spec: ChildSpec, variables: dict[str, str]) -> _Process:
    """Fork; in the child, do the work and exit."""
    parent_pid = os.getpid()
    sys.stdout.flush()
    sys.stderr.flush()
    # Block signals until the child has installed its own handlers.
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    pid = os.fork()
    if pid == 0:
        _run_fork(spec, variables, parent_pid)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
    return _Fork(pid)


def _run_fork(spec: ChildSpec, variables: dict[str, str], parent_pid: int) -> NoReturn:
    code, name, work = 1, spec.name, spec.fork
    assert work is not None
    try:
        die_with_parent(parent_pid)
        Path("/proc/self/comm").write_text(name, "utf-8")  # for `ps` and `top`, which show 15 bytes
        stop = stop_on_signals()
        signs = SignsOfLife(variables)
        stop.on_look = signs.give
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
        configure_logging(name, logging.getLevelName(logging.getLogger().level))
        code = outermost(name, lambda: work(stop, signs.report_jobs))
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)  # the exit handlers and open files are the parent's


def use_one_thread_for_arithmetic() -> None:
    """Keep OpenBLAS and OpenMP from starting threads; call before the first import of numpy.

    A fork copies only the calling thread: a lock held by another thread stays locked in the
    child. Twelve workers on two cores need no further threads.
    """
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[variable] = "1"


class ChildCount:
    """How many children to run: one for each job, within limits.

    After `idle_s` [s] without work a child is not needed.
    """

    def __init__(self, least: int, most: int, idle_s: float = 30.0) -> None:
        self._least, self._most, self._idle_s = least, most, idle_s
        self._count = least
        self._needed_s = 0.0

    def wanted(self, jobs: int, now_s: float) -> int:
        """Return how many children to run for the jobs of all children together."""
        needed = min(max(jobs, self._least), self._most)
        if needed >= self._count:
            self._count, self._needed_s = needed, now_s
        elif now_s - self._needed_s > self._idle_s:
            self._count = needed
        return self._count


def run_forked(
    count: ChildCount,
    child_main: Callable[[int, StopFlag, ReportJobs], None],
    stop: StopFlag,
    *,
    name: str,
    hung_after_s: float = FORK_HUNG_AFTER_S,
) -> None:
    """Keep forked children, called ``name-index``, alive until `stop` is set, then end them.

    Only children without a job are ended before. `child_main` gets the index from 0, the child's
    stop flag and what reports its jobs. It opens its own Zenoh session; the parent
    must never have opened one. A child that does not check its flag for `hung_after_s` is killed.

    Raises:
        RuntimeError: this process has threads, so a fork is not safe.
    """
    if stop.is_set():
        return  # the exit timer is a thread, see `stop_on_signals`
    threads = sum(1 for _ in Path("/proc/self/task").iterdir())  # also those of libraries
    if threads > 1:
        raise RuntimeError(
            f"{threads} threads run at the fork: fork before opening a Zenoh session, "
            "and call use_one_thread_for_arithmetic() before importing numpy"
        )
    gc.collect()
    gc.freeze()  # else the collector writes to, and so copies, every shared page
    supervisor = Supervisor(hung_after_s=hung_after_s)
    try:
        while True:
            jobs, now_s = supervisor.jobs(), time.monotonic()
            wanted = count.wanted(sum(filter(None, jobs.values())), now_s)
            taken = jobs.keys() | supervisor.pids().keys()
            free = (index for index in itertools.count() if f"{name}-{index}" not in taken)
            for index in itertools.islice(free, max(wanted - len(jobs), 0)):
                supervisor.add(ChildSpec(f"{name}-{index}", fork=partial(child_main, index)))
            idle = [child for child, held in jobs.items() if held == 0]
            for child in idle[::-1][: max(len(jobs) - wanted, 0)]:
                supervisor.remove(child)
            if supervisor.wait(stop):
                return
            for ended in supervisor.poll(time.monotonic()):
                _log.warning(
                    "%s ended with code %d; restarting in %.1f s",
                    *(ended.name, ended.code, ended.restart_in_s),
                )
    finally:
        supervisor.stop(_TERMINATE_FORKS_WITHIN_S)


def work_without_preempting() -> None:
    """Give this thread the policy SCHED_BATCH, so that it preempts no other thread when it wakes.

    A scan wakes all workers of a machine at once. With the default policy each interrupts
    another, whose data then leaves the cache. Threads that exist already keep their policy.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    except OSError as error:
        _log.debug("default scheduling policy kept: %s", error)
