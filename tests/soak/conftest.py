"""Folders for long runs."""

import tempfile
from collections.abc import Iterator

import pytest


@pytest.fixture
def short_folder() -> Iterator[str]:
    """For sockets: their paths have at most 107 bytes, and pytest's folders are deep."""
    with tempfile.TemporaryDirectory(prefix="mcl-") as folder:
        yield folder
