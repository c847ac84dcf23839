"""Output of commands: files, checked before the work starts, and standard output."""

import errno
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from clustermcl.protocol.errors import ClusterMclError

_DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}


class OutputError(ClusterMclError):
    """A result cannot be written."""

    def __init__(self, *, path: Path, problem: str) -> None:
        self.path, self.problem = path, problem
        super().__init__(f"{path}: cannot be written: {problem}")


def check_output_file(path: Path) -> None:
    """Check that a file can be written, without changing it.

    Raises:
        OutputError: `path` is a folder, its folder does not exist, or permission is denied.
    """
    if path.is_dir():
        raise OutputError(path=path, problem="it is a folder")
    if path.exists():
        if not os.access(path, os.W_OK):
            raise OutputError(path=path, problem="it may not be written to")
        return
    if not path.parent.is_dir():
        raise OutputError(path=path, problem="its folder does not exist")
    try:
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise OutputError(path=path, problem=error.strerror or str(error)) from error


def write_output_file(path: Path, content: str | bytes) -> None:
    """Write a file, text in UTF-8; an `OutputError` says why it cannot be written."""
    try:
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    except OSError as error:
        raise OutputError(path=path, problem=error.strerror or str(error)) from error


@contextmanager
def written_output() -> Iterator[None]:
    """Flush everything printed within this context, or raise.

    Raises:
        OutputError: the disk is full or failed.
        BrokenPipeError: the reader of a pipe has closed it.
    """
    try:
        try:
            yield
        finally:
            if sys.stdout is not None:  # None if the parent process has closed it
                sys.stdout.flush()
    except OSError as error:
        if error.errno not in _DISK_ERRORS or sys.stdout is None:
            raise
        # Drop the buffer, which would fail again at the interpreter's exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        problem = error.strerror or str(error)
        raise OutputError(path=Path("standard output"), problem=problem) from error
