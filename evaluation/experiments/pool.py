"""Runs in parallel processes."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import TypeVar

from process_runtime.parent import die_with_parent
from process_runtime.stop import StopFlag
from protocol.errors import ClusterMclError

T = TypeVar("T")
R = TypeVar("R")

_POLL_S = 0.2
_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class RunError(ClusterMclError):
    """A run failed, or its process ended."""

    def __init__(self, *, run: int, problem: str) -> None:
        self.run, self.problem = run, problem
        super().__init__(f"run {run}: {problem}")


def in_parallel(
    work: Callable[[T], R], pieces: Sequence[T], jobs: int, stop: StopFlag
) -> Iterator[tuple[int, R]]:
    """Call a function with each piece, each call in one of several spawned processes.

    Args:
        work: a function of a module.
        pieces: its arguments, begun in this order.
        jobs: how many processes; each uses one thread.
        stop: ends all processes, and then the iterator.

    Yields:
        Index and result of each piece, as they end.

    Raises:
        RunError: a call has raised a `ClusterMclError`, or its process was killed; the other
            calls are ended.
    """
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))  # one process a core is enough
    pool = ProcessPoolExecutor(
        min(jobs, len(pieces)) or 1,
        multiprocessing.get_context("spawn"),
        _ignore_signals,
        (os.getpid(),),
    )
    index = 0
    try:
        indices = {pool.submit(_attempt, work, piece): run for run, piece in enumerate(pieces)}
        pending = set(indices)
        while pending and not stop.is_set():
            done, pending = wait(pending, _POLL_S, FIRST_COMPLETED)
            for future in done:
                index, result = indices[future], future.result()
                if isinstance(result, _Failure):
                    raise RunError(run=index, problem=result.problem)
                yield index, result
    except BrokenProcessPool as error:
        problem = "a process ended in the middle of a run: is there enough memory?"
        raise RunError(run=index, problem=problem) from error
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for child in multiprocessing.active_children():
            child.kill()
            child.join()


@dataclass(frozen=True)
class _Failure:
    """An error as text: our errors have keyword arguments, and pickle cannot restore those."""

    problem: str


def _attempt(work: Callable[[T], R], piece: T) -> R | _Failure:
    try:
        return work(piece)
    except ClusterMclError as error:
        return _Failure(str(error))


def _ignore_signals(parent_pid: int) -> None:
    """Ctrl-C goes to all processes of a terminal; the parent decides what to do."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    die_with_parent(parent_pid)
