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

    def __init__(self, path: Path, problem: str | OSError) -> None:
        self.path = path
        self.problem = problem if isinstance(problem, str) else problem.strerror or str(problem)
        super().__init__(f"{path}: cannot be written: {self.problem}")


def check_output_file(path: Path, ending: str = "") -> None:
    """Check a file's name, and that it can be written; an `OutputError` says why not."""
    if not path.name.lower().endswith(ending):
        raise OutputError(path, f"its name must end in {ending}")
    if path.is_dir():
        raise OutputError(path, "it is a folder")
    if path.exists():
        if not os.access(path, os.W_OK):
            raise OutputError(path, "it may not be written to")
    elif not path.parent.is_dir():
        raise OutputError(path, "its folder does not exist")
    else:
        try:
            tempfile.TemporaryFile(dir=path.parent).close()
        except OSError as error:
            raise OutputError(path, error) from error


def write_output_file(path: Path, content: str | bytes) -> None:
    """Write a file, text in UTF-8; an `OutputError` says why it cannot be written."""
    try:
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    except OSError as error:
        raise OutputError(path, error) from error


def replace_file(path: Path, content: bytes) -> None:
    """Replace a file as a whole, so that it survives a power cut; only its owner may read it.

    After an `OSError` the old file is still there.
    """
    part = path.with_suffix(".part")  # one name: what a killed process left is written over
    try:
        write_over(part, content, sync=True)
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)
        raise
    number = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(number)  # wait until the renamed file's name is on the disk
    finally:
        os.close(number)


def write_over(path: Path, content: bytes, *, sync: bool = False) -> None:
    """Write a file over; create its folder if it is missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT, 0o600), "wb") as file:
        file.write(content)
        file.truncate()
        if sync:
            os.fsync(file.fileno())


@contextmanager
def written_output() -> Iterator[None]:
    """Flush what is printed within this context; an `OutputError`: the disk is full or failed."""
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
        raise OutputError(Path("standard output"), error) from error
