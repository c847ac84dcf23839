"""Property tests check what is computed, not how fast a shared machine computes it."""

import tempfile
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings

from clustermcl.filter.settings import SensorSettings
from clustermcl.jobs.warm_up import compile_kernels

settings.register_profile(
    "shared machine", deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("shared machine")


@pytest.fixture
def short_folder() -> Iterator[str]:
    """For sockets: their paths have at most 107 bytes, and pytest's folders are deep."""
    with tempfile.TemporaryDirectory(prefix="mcl-") as folder:
        yield folder


def pytest_configure(config: pytest.Config) -> None:
    """Build the library of kernels once, before all processes of a run."""
    if not hasattr(config, "workerinput"):
        compile_kernels(SensorSettings())
