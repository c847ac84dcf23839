"""Starts the processes of this machine, restarts dead ones, and ends them all."""

import logging
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from process_runtime.backoff import Backoff
from process_runtime.main import EXIT_ERROR, EXIT_OK
from process_runtime.parent import PARENT_VARIABLE
from process_runtime.watchdog import Listener

_log = logging.getLogger(__name__)

_TERMINATE_WITHIN_S = 1.5
_GIVEN_UP_BEFORE_S = 10.0
HUNG_AFTER_S = 15.0
"""A turn of a process's loop takes less than a second."""
_LAST_WORDS_BYTES = 4096
_STANDARD_ERROR = 2


def python_module(module: str, *arguments: str) -> list[str]:
    """Return the command of one of our modules; ``-I`` ignores modules in the current folder."""
    return [sys.executable, "-I", "-m", module, *arguments]


@dataclass(frozen=True)
class ChildSpec:
    """A process to keep alive."""

    name: str
    command: Sequence[str]
    """Program and arguments; see `python_module`."""
    log: Path | None = None
    """File for its output (appended); None: this process's standard error."""
    restart: Literal["always", "on-failure"] = "always"
    """Whether exit code 0 is final: a recording ends, a router does not."""


@dataclass(frozen=True)
class ChildExit:
    """A child has ended."""

    name: str
    code: int
    """Exit code; negative for a signal, such as -9 for SIGKILL."""
    restart_in_s: float | None
    """None: it is not restarted, because it has finished or refused to start."""
    last_words: str
    """Last line of its log file, the error if the code is 2; empty without a log file."""


class Supervisor:
    """Child processes that are restarted and never outlive this process.

    The kernel ends a child when the *thread* that started it ends: call `start` and `poll` from
    one long-lived thread. A child that rejects its settings (exit code 2 soon after its start)
    is not restarted. One that stops giving signs of life is killed and restarted.
    """

    def __init__(
        self, children: Sequence[ChildSpec], *, hung_after_s: float = HUNG_AFTER_S
    ) -> None:
        """Create the supervisor; `start` starts the children.

        Args:
            children: the processes to keep alive.
            hung_after_s: a child without a sign of life for this time is killed [s].

        Raises:
            ValueError: two have the same name.
        """
        if len({child.name for child in children}) < len(children):
            raise ValueError("two children have the same name")
        self._hung_after_s = hung_after_s
        self._children = [_Child(spec, hung_after_s) for spec in children]

    def start(self) -> None:
        for child in self._children:
            child.start()

    def add(self, spec: ChildSpec) -> None:
        """Start one more child, after those that it depends on.

        Raises:
            ValueError: there is one of the same name.
        """
        if any(child.spec.name == spec.name for child in self._children):
            raise ValueError(f"there is a child {spec.name!r} already")
        child = _Child(spec, self._hung_after_s)
        self._children.append(child)
        child.start()

    def poll(self, now_s: float) -> list[ChildExit]:
        """Restart children that are due; return those that ended since the last call.

        Args:
            now_s: `time.monotonic` [s].
        """
        ended = []
        for child in self._children:
            child.start_if_due(now_s)
            child.kill_if_hung(now_s)
            if (exit_ := child.exited(now_s)) is not None:
                ended.append(exit_)
        return ended

    def pids(self) -> dict[str, int]:
        """Return the process ids of the running children by name."""
        return {
            child.spec.name: child.process.pid
            for child in self._children
            if child.process is not None
        }

    def stop(self) -> None:
        """End all children within 2 s: SIGTERM, then SIGKILL after 1.5 s."""
        running = [child.process for child in self._children if child.process is not None]
        for process in running:
            process.terminate()
        deadline_s = time.monotonic() + _TERMINATE_WITHIN_S
        for process in running:
            try:
                process.wait(max(0.0, deadline_s - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
        for child in self._children:
            child.forget()


class _Child:
    """One child: the present process and when to start the next."""

    def __init__(self, spec: ChildSpec, hung_after_s: float) -> None:
        self.spec, self._hung_after_s = spec, hung_after_s
        self.process: subprocess.Popen[bytes] | None = None
        self._backoff = Backoff()
        self._started_at_s = 0.0
        self._start_at_s: float | None = None
        self._listener: Listener | None = None

    def start(self) -> None:
        with ExitStack() as stack:
            log = None
            if self.spec.log is not None:
                log = stack.enter_context(self.spec.log.open("ab"))
            self._start_at_s = None
            self._started_at_s = time.monotonic()
            self._listener = Listener(self._hung_after_s)
            # Its own process group: Ctrl-C reaches only this process, which ends the others.
            self.process = subprocess.Popen(
                self.spec.command,
                stdin=subprocess.DEVNULL,
                # This process's standard output may be one JSON object.
                stdout=log or _STANDARD_ERROR,
                stderr=log or _STANDARD_ERROR,
                env={
                    **os.environ,
                    PARENT_VARIABLE: str(os.getpid()),
                    **self._listener.variables(),
                },
                process_group=0,
            )

    def start_if_due(self, now_s: float) -> None:
        if self._start_at_s is not None and now_s >= self._start_at_s:
            self.start()

    def kill_if_hung(self, now_s: float) -> None:
        if self.process is None or self._listener is None or not self._listener.is_hung(now_s):
            return
        _log.warning("%s hung for %g s: killed", self.spec.name, self._hung_after_s)
        self._hear_no_more()
        self.process.kill()

    def exited(self, now_s: float) -> ChildExit | None:
        """Return the exit once, and schedule the restart."""
        if self.process is None or (code := self.process.poll()) is None:
            return None
        self.process = None
        self._hear_no_more()
        lived_s = now_s - self._started_at_s
        done = code == EXIT_OK and self.spec.restart == "on-failure"
        refused = code == EXIT_ERROR and lived_s < _GIVEN_UP_BEFORE_S
        wait_s = None if done or refused else self._backoff.after_death(lived_s)
        self._start_at_s = None if wait_s is None else now_s + wait_s
        return ChildExit(self.spec.name, code, wait_s, self._last_words())

    def forget(self) -> None:
        """Reap the process and cancel its restart."""
        if self.process is not None:
            self.process.wait()
        self.process, self._start_at_s = None, None
        self._hear_no_more()

    def _hear_no_more(self) -> None:
        if self._listener is not None:
            self._listener.close()
        self._listener = None

    def _last_words(self) -> str:
        if self.spec.log is None:
            return ""
        with self.spec.log.open("rb") as log:
            log.seek(max(0, self.spec.log.stat().st_size - _LAST_WORDS_BYTES))
            lines = log.read().decode(errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "")
