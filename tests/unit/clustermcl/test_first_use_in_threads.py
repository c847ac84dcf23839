"""Whatever msgspec inspects, several threads may use first: in processes that have not used it."""

from pathlib import Path

import pytest

from clustermcl.simulator.worlds.catalogue import world
from tests.maps import write_map
from tests.unit.programs import ran

SETTINGS_FILE = """
from pathlib import Path
from clustermcl.runtime.settings_file import load_settings
use = lambda: load_settings(Path(folder, "settings.toml"), ["search.poses=200"])
"""
LIBRARY = """
from clustermcl.filter.settings import SensorSettings
from clustermcl.jobs.warm_up import compile_kernels
compile_kernels(SensorSettings())
from clustermcl import ClusterMCL, Reading, load_landmarks, load_map
ClusterMCL, Reading

def use():
    mcl = ClusterMCL(
        load_map(f"{folder}/map.yaml"), landmarks=load_landmarks(f"{folder}/landmarks.yaml"),
        settings={"search.poses": 200, "search.heading_step_rad": 0.2, "search.shards": 1},
    )
    for x in range(3):
        mcl.update(Reading((x / 2, 0.0, 0.0), [1.0] * 20, angle_step=0.3, range_max=9.0))
"""
USED_BY_FIVE_THREADS = """
import faulthandler, os, sys, threading
sys.setswitchinterval(1e-4)
faulthandler.enable()
for _ in range(int(times)):
    if not (child := os.fork()):
        together, done = threading.Barrier(5), []
        def run():
            together.wait()
            use()
            done.append(1)
        threads = [threading.Thread(target=run) for _ in range(5)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        os._exit(len(done) != 5)
    if status := os.waitpid(child, 0)[1]:
        sys.exit(f"ended with {os.waitstatus_to_exitcode(status)}")
"""


@pytest.mark.parametrize(
    ("use", "times"), [(SETTINGS_FILE, 60), (LIBRARY, 5)], ids=["a settings file", "the library"]
)
def test_several_threads_may_use_it_first(use: str, times: int, tmp_path: Path) -> None:
    write_map(world("cross_feature").map, tmp_path, "map")
    (tmp_path / "landmarks.yaml").write_text("landmarks: [{id: tag, x: 1.0, y: 1.0}]")
    (tmp_path / "settings.toml").write_text("[cluster]\nparticles = 300\n")
    program = f"import sys\nfolder, times = sys.argv[1:]\n{use}\n{USED_BY_FIVE_THREADS}"
    ended = ran(program, str(tmp_path), str(times), check=False, timeout_s=200.0)
    assert ended.returncode == 0, ended.stderr[-2_000:]
