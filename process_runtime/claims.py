"""Claims of files and folders by running processes; the kernel ends a claim with its process."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def claimed(lock: Path) -> Iterator[bool]:
    """Claim what a lock file stands for; yield whether no other process has claimed it.

    Raises:
        OSError: the file cannot be opened or created.
    """
    number = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    try:
        try:
            fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True
    finally:
        os.close(number)
