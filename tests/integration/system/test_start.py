import os
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.integration.system.commands import ran
from tests.integration.worlds import write_room

COMPILING_S = 250.0
"""Time-out of compiling all kernels, 20 s on an idle machine [s]."""


@pytest.mark.skipif(not shutil.which(os.environ.get("CC", "cc")), reason="no C compiler")
def test_two_first_starts_at_once_build_one_library_of_kernels(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}

    def warm_up(_: int) -> subprocess.CompletedProcess[str]:
        return ran("warm-up", environment=environment, timeout_s=COMPILING_S)

    with ThreadPoolExecutor() as pool:
        starts = list(pool.map(warm_up, range(2)))
    assert [start.returncode for start in starts] == [0, 0]
    assert len(list(tmp_path.glob("kernels-*.so"))) == 1


def test_warm_up_prepares_kernels_and_the_map(tmp_path: Path, environment: dict[str, str]) -> None:
    map_file = write_room(tmp_path, cells=(20, 20))
    command = ("warm-up", "--set", f"bridge.map={map_file}")
    warm = ran(*command, environment=environment, timeout_s=COMPILING_S)
    assert (warm.returncode, warm.stdout) == (0, "")
    assert "all kernels are on disk" in warm.stderr
    assert list((tmp_path / "clustermcl" / "maps").glob("field-*"))
