"""Work in parallel processes: a failing piece, or a process that dies, costs only that piece."""

import multiprocessing
import os
import signal
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import connection
from pathlib import Path
from typing import Generic, TypeVar

from process_runtime.parent import die_with_parent
from process_runtime.stop import StopFlag
from protocol.errors import ClusterMclError

T = TypeVar("T")
R = TypeVar("R")

Work = Callable[[T, Callable[[int], None]], R]
"""Does a piece; the second argument is to be told how much has been done since it was last."""

_POLL_S = 0.2
_END_WITHIN_S = 2.0
_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Advanced:
    """A piece has got on."""

    piece: int
    amount: int


@dataclass(frozen=True)
class Done(Generic[R]):
    """A piece is done."""

    piece: int
    result: R


@dataclass(frozen=True)
class Failed:
    """A piece failed; the others go on."""

    piece: int
    problem: str


def in_parallel(
    work: Work[T, R], pieces: Sequence[T], jobs: int, stop: StopFlag
) -> Iterator[Advanced | Done[R] | Failed]:
    """Do all pieces, in their order, so many at a time, each in a process of its own kind.

    Processes are spawned, live as long as there is work, and die with this one. When `stop` is
    set they are ended, and the iterator ends after what was done.

    Args:
        work: a function of a module; it is imported by the processes.
        pieces: what it is called with.
        jobs: how many processes.
        stop: looked at several times a second.
    """
    waiting = deque(enumerate(pieces))
    with _one_thread_each():
        crew = [_Worker(work) for _ in range(min(jobs, len(pieces)))]
        try:
            for worker in crew:
                worker.give(*waiting.popleft())
            while busy := [worker for worker in crew if worker.piece is not None]:
                if stop.is_set():
                    return
                for worker in _speaking(busy):
                    event = worker.hear()
                    if not isinstance(event, Advanced) and waiting:
                        worker.give(*waiting.popleft())
                    yield event
        finally:
            for worker in crew:
                worker.end()


class _Worker(Generic[T, R]):
    """A process and the pipe to it."""

    def __init__(self, work: Work[T, R]) -> None:
        self._work = work
        self.piece: int | None = None
        self._start()

    def give(self, piece: int, argument: T) -> None:
        """Give it a piece; one that died meanwhile is replaced first."""
        if not self._process.is_alive():
            self.end()
            self._start()
        self.piece = piece
        with suppress(ConnectionError):  # it died this moment: `hear` will say so
            self.pipe.send(argument)

    def hear(self) -> Advanced | Done[R] | Failed:
        """What it has to say about its piece; that it died, if it did."""
        piece = self.piece
        assert piece is not None  # only busy ones are heard
        try:
            kind, value = self.pipe.recv()
        except (EOFError, ConnectionError):
            self._process.join(_END_WITHIN_S)
            kind, value = "failed", f"its process ended with {self._process.exitcode}"
        if kind == "advanced":
            return Advanced(piece, value)
        self.piece = None
        return Done(piece, value) if kind == "done" else Failed(piece, value)

    def end(self) -> None:
        """End the process, whatever it does."""
        self.pipe.close()
        self._process.kill()
        self._process.join(_END_WITHIN_S)

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        arguments = (self._work, theirs, os.getpid())
        self._process = context.Process(target=_serve, args=arguments, daemon=True)
        self._process.start()
        theirs.close()


def _speaking(busy: Sequence[_Worker[T, R]]) -> list[_Worker[T, R]]:
    by_pipe = {worker.pipe: worker for worker in busy}
    ready = connection.wait(list(by_pipe), timeout=_POLL_S)
    return [worker for pipe, worker in by_pipe.items() if pipe in ready]


def _serve(
    work: Work[T, R], pipe: "connection.Connection[tuple[str, object], T]", parent_pid: int
) -> None:
    """The process's outermost loop: pieces in, results out, until the other side closes."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # both may go to the whole group; one decides
    die_with_parent(parent_pid)
    while True:
        try:
            argument = pipe.recv()
        except EOFError:
            return
        try:
            result = work(argument, lambda amount: pipe.send(("advanced", amount)))
        except ClusterMclError as error:
            pipe.send(("failed", " ".join(str(error).split())))
        except Exception as error:  # noqa: BLE001 - a process's outermost loop
            frame = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{Path(frame.filename).name}:{frame.lineno}"
            pipe.send(("failed", f"{type(error).__name__} in {where}: {error}"))
        else:
            pipe.send(("done", result))


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Children started within use one thread for linear algebra; one process a core is enough."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
