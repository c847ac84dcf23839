import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.integration.system.commands import ran

HEAVY = {"numba", "llvmlite", "scipy"}
"""Of the 160 MB of a process that computes, 100 are these."""


@pytest.mark.parametrize(
    "module",
    [
        "sensor_bridge.process",
        "coordinator.process",
        "zenoh_link.router",
        "clustermcl.client",
        "clustermcl.up",
    ],
)
def test_processes_without_mathematics_import_neither_numba_nor_scipy(module: str) -> None:
    program = f"import sys, {module}; print(sorted({HEAVY} & set(sys.modules)))"
    ran = subprocess.run(
        [sys.executable, "-I", "-c", program], capture_output=True, text=True, check=True
    )
    assert ran.stdout.strip() == "[]"


@pytest.mark.skipif(not shutil.which(os.environ.get("CC", "cc")), reason="no C compiler")
def test_two_first_starts_at_once_build_one_library_of_kernels(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    with ThreadPoolExecutor() as pool:
        starts = list(pool.map(lambda _: ran("warm-up", environment=environment), range(2)))
    assert [start.returncode for start in starts] == [0, 0]
    assert len(list(tmp_path.glob("kernels-*.so"))) == 1


def test_warm_up_prepares_kernels_and_the_map(tmp_path: Path) -> None:
    (tmp_path / "map.pgm").write_bytes(b"P5 20 20 255\n" + bytes(20) + b"\xfe" * 380)
    description = "image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\n"
    thresholds = "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    (tmp_path / "map.yaml").write_text(description + thresholds)
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    warm = ran("warm-up", "--set", f"bridge.map={tmp_path / 'map.yaml'}", environment=environment)
    assert (warm.returncode, warm.stdout) == (0, "")
    assert "all kernels are on disk" in warm.stderr
    assert list((tmp_path / "clustermcl").glob("field-*"))


@pytest.mark.parametrize("setting", ["bridge.map=missing.yaml", "sensor.hit_sigma_m=-1"])
def test_warm_up_refuses_a_missing_map_or_a_wrong_setting(setting: str) -> None:
    refused = ran("warm-up", "--set", setting)
    assert refused.returncode == 2
    assert setting.partition("=")[2] in refused.stderr
    assert len(refused.stderr.splitlines()) <= 2
