"""Computes advice in a child process, so that no step waits for it."""

import multiprocessing
import os
import signal
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection

from clustermcl.link.node import Node
from clustermcl.protocol.advice import Advice, AdviceQuestion
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.steps import Scan
from clustermcl.runtime.parent import die_with_parent
from clustermcl.worker.worker import Advise

IDLE_S = 60.0
"""The child ends after this time without a question, and its memory with it [s]."""
NICENESS = 10
"""Of the child: where cores are few, steps come first."""


class Adviser:
    """The child process of a worker that computes its advice, one question after another.

    It is forked at the first question, loads scipy, which takes 0.4 s and 24 MB, and ends when it
    is idle. Of several questions that wait, only the newest is computed. The node's loop calls all
    methods.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._child: _Child | None = None
        self._is_busy = False
        self._waiting: Advise | None = None

    def advise(self, task: Advise) -> None:
        """Compute an advice in the background, and answer its query."""
        if self._is_busy:
            if self._waiting is not None:
                self._waiting.question.refuse("a newer question arrived; ask again")
            self._waiting = task
            return
        if self._child is None or not self._child.serves(task):
            self.close()
            self._child = _Child(task, self._node.name)
        self._is_busy = True
        self._node.in_background(partial(self._child.computed, task), partial(self._on_done, task))

    def _on_done(self, task: Advise, outcome: Future[Advice]) -> None:
        self._is_busy = False
        try:
            task.question.answer(outcome.result())
        except (EOFError, OSError, MalformedMessageError):
            self.close()
            task.question.refuse("the process that computed the advice has failed; ask again")
        if self._waiting is not None:
            waiting, self._waiting = self._waiting, None
            self.advise(waiting)

    def close(self) -> None:
        if self._child is not None:
            self._child.close()
            self._child = None


class _Child:
    """A child process, which serves questions about one map with one set of settings."""

    def __init__(self, task: Advise, sender: str) -> None:
        # A fork has the sensor model, of tens of megabytes, without a copy.
        context = multiprocessing.get_context("fork")
        self._first = task
        self._connection, of_child = context.Pipe()
        arguments = task, sender, of_child, self._connection, os.getpid()
        self._process = context.Process(target=_serve, args=arguments, daemon=True)
        self._process.start()
        of_child.close()

    def serves(self, task: Advise) -> bool:
        """Return whether the process runs, and computes with the same model and settings."""
        first = self._first
        is_same_map = task.model is first.model and task.landmarks is first.landmarks
        return is_same_map and task.settings == first.settings and self._process.is_alive()

    def computed(self, task: Advise) -> Advice:
        """Return the advice; blocks.

        Raises:
            EOFError, OSError: the process has ended.
            MalformedMessageError: its answer is invalid.
        """
        self._connection.send_bytes(encode(task.asked))
        self._connection.send_bytes(encode(task.scan))
        return decode(self._connection.recv_bytes(), Advice)

    def close(self) -> None:
        self._process.kill()
        self._process.join()
        self._connection.close()


def _serve(
    task: Advise, sender: str, connection: Connection, of_parent: Connection, parent_pid: int
) -> None:
    """Answer questions in the child until `IDLE_S` have passed without one."""
    die_with_parent(parent_pid)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    of_parent.close()
    with suppress(OSError):  # a sandbox forbids it
        os.nice(NICENESS)
    from clustermcl.jobs.advising import advice  # noqa: PLC0415 - scipy, only in the child

    with suppress(EOFError):  # the worker has ended
        while connection.poll(IDLE_S):
            asked = decode(connection.recv_bytes(), AdviceQuestion)
            scan = decode(connection.recv_bytes(), Scan)
            answer = advice(asked, scan, task.model, task.settings, sender, task.landmarks)
            connection.send_bytes(encode(answer))
