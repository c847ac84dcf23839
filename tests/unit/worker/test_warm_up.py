import logging

import pytest

from particle_filter import kernels
from particle_filter.settings import SensorSettings
from worker.warm_up import compile_kernels


@pytest.mark.parametrize("problems", [[], ["disk full", "disk full"]])
def test_kernels_that_cannot_be_cached_are_reported_once_in_one_line(
    problems: list[str], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(kernels, "cache_problems", problems)
    with caplog.at_level(logging.WARNING):
        compile_kernels(SensorSettings())
    assert len(caplog.messages) == bool(problems)
    for line in caplog.messages:
        assert "kernels cannot be kept on disk: disk full; " in line
        assert "NUMBA_CACHE_DIR" in line
