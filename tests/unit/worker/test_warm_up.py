import logging
import subprocess
import sys

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


NEW_KERNELS = """
import gc
from numba.core.dispatcher import Dispatcher
from particle_filter.settings import SensorSettings
from worker.warm_up import compile_kernels

def compiled():
    all_kernels = [each for each in gc.get_objects() if isinstance(each, Dispatcher)]
    return {f"{each.py_func.__name__}{each.signatures}" for each in all_kernels}

compile_kernels(SensorSettings())
from evaluation.evaluate import *
before = compiled()
from clustermcl.command import app
app(["evaluate", "sim:cross_tags", "--steps", "40", "--jobs", "1"], standalone_mode=False)
print("new:", sorted(compiled() - before))
"""


def test_no_kernel_is_compiled_while_a_robot_drives() -> None:
    ran = subprocess.run(
        [sys.executable, "-I", "-c", NEW_KERNELS], capture_output=True, text=True, check=True
    )
    assert ran.stdout.splitlines()[-1] == "new: []"
