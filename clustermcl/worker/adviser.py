"""Computes each advice in a child process of its own, so that no step waits for it."""

import multiprocessing
import os
import signal
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.context import ForkProcess

from clustermcl.link.node import Node
from clustermcl.protocol.advice import Advice
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.runtime.parent import die_with_parent
from clustermcl.worker.worker import Advise

LONGEST_S = 60.0
"""A child that has not answered for longer hangs [s]."""
NICENESS = 10
"""Of the child: where cores are few, steps come first."""


class Adviser:
    """Computes a worker's advice, one at a time; of several questions that wait, the newest.

    A fork has the sensor model, of tens of megabytes, without a copy, and scipy's memory ends with
    it.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._child: ForkProcess | None = None
        self._waiting: Advise | None = None

    def advise(self, task: Advise) -> None:
        """Compute an advice in the background, and answer its query."""
        if self._child is not None:
            if self._waiting is not None:
                self._waiting.question.refuse("a newer question arrived; ask again")
            self._waiting = task
            return
        context = multiprocessing.get_context("fork")
        of_parent, of_child = context.Pipe(duplex=False)
        arguments = task, self._node.name, of_child, os.getpid()
        self._child = context.Process(target=_compute, args=arguments, daemon=True)
        self._child.start()
        of_child.close()
        on_done = partial(self._on_done, task, self._child, of_parent)
        self._node.in_background(partial(_received, of_parent), on_done)

    def _on_done(
        self, task: Advise, child: ForkProcess, connection: Connection, outcome: Future[Advice]
    ) -> None:
        child.kill()
        child.join()
        connection.close()
        self._child = None
        try:
            task.question.answer(outcome.result())
        except (EOFError, OSError, MalformedMessageError):
            task.question.refuse("the process that computed the advice has failed; ask again")
        if self._waiting is not None:
            waiting, self._waiting = self._waiting, None
            self.advise(waiting)


def _received(connection: Connection) -> Advice:
    if not connection.poll(LONGEST_S):
        raise TimeoutError
    return decode(connection.recv_bytes(), Advice)


def _compute(task: Advise, sender: str, connection: Connection, parent_pid: int) -> None:
    die_with_parent(parent_pid)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    with suppress(OSError):  # a sandbox forbids it
        os.nice(NICENESS)
    from clustermcl.jobs.advising import advice  # noqa: PLC0415 - scipy, only in the child

    answer = advice(task.asked, task.scan, task.model, task.settings, sender)
    connection.send_bytes(encode(answer))
