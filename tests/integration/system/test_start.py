"""What processes load: mathematics only where it is done."""

import subprocess
import sys

import pytest

HEAVY = {"numba", "llvmlite", "scipy"}
"""Of the 160 MB of a process that computes, 100 are these."""


@pytest.mark.parametrize(
    "module",
    ["sensor_bridge.process", "coordinator.process", "zenoh_link.router", "clustermcl.client"],
)
def test_processes_without_mathematics_import_neither_numba_nor_scipy(module: str) -> None:
    program = f"import sys, {module}; print(sorted({HEAVY} & set(sys.modules)))"
    ran = subprocess.run(
        [sys.executable, "-I", "-c", program], capture_output=True, text=True, check=True
    )
    assert ran.stdout.strip() == "[]"
