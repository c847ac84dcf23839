"""Tests that load the machine run one after another, also where pytest has several processes."""

import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def one_at_a_time() -> Iterator[None]:
    """The lock of all who load this machine."""
    path = Path(tempfile.gettempdir()) / f"clustermcl-load-{os.getuid()}.lock"
    with path.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
