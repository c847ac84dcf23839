"""Where the tests find recordings and maps that are not redistributed with the product."""

import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[3]


def data_folder() -> Path:
    """The folder of recordings: CLUSTERMCL_DATA, else `shared/data` next to the repository."""
    named = os.environ.get("CLUSTERMCL_DATA")
    return Path(named) if named else REPOSITORY.parent / "shared" / "data"


def recording_or_skip(relative_path: str) -> Path:
    """A file of that folder; the test is skipped where it is not there."""
    path = data_folder() / relative_path
    if not path.is_file():
        pytest.skip(f"{relative_path} is not in {data_folder()}; set CLUSTERMCL_DATA to have it")
    return path
