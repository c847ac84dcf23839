"""Standard output that cannot be written: the disk that it goes to is full, or errs."""

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from protocol.errors import ClusterMclError

_DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}


class OutputLostError(ClusterMclError):
    """What a command printed could not be written."""

    def __init__(self, *, problem: str) -> None:
        self.problem = problem
        super().__init__(f"the output cannot be written: {problem}")


def standard_output() -> TextIO:
    """Where a command writes what it was asked for.

    Raises:
        OutputLostError: whoever started it has closed it.
    """
    if sys.stdout is None:
        raise OutputLostError(problem="standard output is closed")
    return sys.stdout


@contextmanager
def written_output() -> Iterator[None]:
    """Print in here: all of it is written when the context is left, or an error says so.

    Raises:
        OutputLostError: the disk is full or errs. The reader of a pipe who has seen enough is
            a BrokenPipeError, as ever.
    """
    try:
        try:
            yield
        finally:
            if sys.stdout is not None:  # it is None where who started us has closed it
                sys.stdout.flush()
    except OSError as error:
        if error.errno not in _DISK_ERRORS:
            raise
        if sys.stdout is not None:
            _discard_the_rest()
        raise OutputLostError(problem=error.strerror or str(error)) from error


def _discard_the_rest() -> None:
    """What waits in the buffer would fail once more at the interpreter's exit."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)
