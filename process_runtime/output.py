"""Reports failures of standard output, such as a full disk, as errors."""

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from protocol.errors import ClusterMclError

_DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}


class OutputLostError(ClusterMclError):
    """A command's output could not be written."""

    def __init__(self, *, problem: str) -> None:
        self.problem = problem
        super().__init__(f"the output cannot be written: {problem}")


def standard_output() -> TextIO:
    """Return standard output.

    Raises:
        OutputLostError: the parent process has closed it.
    """
    if sys.stdout is None:
        raise OutputLostError(problem="standard output is closed")
    return sys.stdout


@contextmanager
def written_output() -> Iterator[None]:
    """Flush everything printed within this context, or raise.

    Raises:
        OutputLostError: the disk is full or failed.
        BrokenPipeError: the reader of a pipe has closed it.
    """
    try:
        try:
            yield
        finally:
            if sys.stdout is not None:  # None if the parent process has closed it
                sys.stdout.flush()
    except OSError as error:
        if error.errno not in _DISK_ERRORS:
            raise
        if sys.stdout is not None:
            _discard_the_rest()
        raise OutputLostError(problem=error.strerror or str(error)) from error


def _discard_the_rest() -> None:
    """Drop the buffer, which would fail again at the interpreter's exit."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, sys.stdout.fileno())
    os.close(null)
