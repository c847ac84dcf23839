"""What processes load: mathematics only where it is done."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from clustermcl.client import Client
from process_runtime.settings import Settings, ZenohSettings
from tests.integration.system.commands import SMALL_FILTER, typed
from tests.integration.waiting import wait_until

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


def heavy_libraries(process: psutil.Process) -> set[str]:
    files = {Path(mapped.path).parts for mapped in process.memory_maps()}
    return {name for name in HEAVY if any(name in parts for parts in files)}


def test_running_processes_without_mathematics_map_neither_numba_nor_scipy(
    zenoh_settings: ZenohSettings, short_folder: str, tmp_path: Path
) -> None:
    words = [
        "up", "--set", f"zenoh.router={zenoh_settings.router}", "--set", "worker.count=2",
        "--set", "bridge.source=sim:cross", "--set", "bridge.rate=4", *SMALL_FILTER,
    ]  # fmt: skip
    environment = {
        **os.environ, "TMPDIR": short_folder, "XDG_CACHE_HOME": str(tmp_path),
        "XDG_STATE_HOME": str(tmp_path),
    }  # fmt: skip
    settings = Settings(zenoh=zenoh_settings)
    with typed(*words, folder=tmp_path, environment=environment) as up, Client(settings) as client:
        wait_until(lambda: client.pose().probability > 0.0)
        loaded = {
            module: heavy_libraries(process)
            for process in up.meet_family()
            for module in ("coordinator", "zenoh_link.router", "worker")
            if module in process.cmdline()
        }
        assert up.end(signal.SIGINT) == 0
    assert loaded.pop("worker") & {"numba", "llvmlite"}
    assert loaded == {"coordinator": set(), "zenoh_link.router": set()}
