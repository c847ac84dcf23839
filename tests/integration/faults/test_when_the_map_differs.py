"""docs/failures.md: the map differs between processes: refused, with both digests."""

import os
import signal
from pathlib import Path

from clustermcl.stack import COORDINATOR, WORKERS
from grid_maps.load import load_map
from process_runtime.supervisor import python_module
from robot_simulator.worlds.catalogue import world
from soak_test.map_file import write_map
from tests.integration.conftest import StartProcess
from tests.integration.faults.system import SIMULATOR, SMALL, system
from tests.integration.waiting import wait_until
from tests.integration.worlds import world_of


def test_scans_and_workers_of_another_map_are_refused_with_both_digests(
    tmp_path: Path, start_process: StartProcess
) -> None:
    ours = world_of(SMALL).map.digest
    other = write_map(world("office").map, tmp_path, "other")
    theirs = load_map(other).digest
    both = f"has map {theirs[:12]}, expected {ours[:12]}"
    with system() as tested, tested.client as client:
        tested.wait_until_it_tracks()
        step = tested.step
        # The bridge is started anew with another map; the supervisor does not look meanwhile.
        tested.hurt(SIMULATOR)
        start_process(
            python_module(
                SIMULATOR, "--settings", str(tested.folder / "settings.toml"), "--map", str(other)
            )
        )
        wait_until(lambda: both in tested.log(COORDINATOR))
        assert client.status().counters["scan of another map"] > 0
        assert tested.since(step + 1) == [], "no step is made of them"
        assert client.status().map_digest == ours
        # A worker that starts now is offered the other map, and does not take it.
        os.kill(tested.worker_pids()[0], signal.SIGKILL)
        wait_until(lambda: both in tested.log(WORKERS))
        wait_until(lambda: client.status().counters.get("order refused", 0) > 0)
        assert len(tested.log(COORDINATOR).split(both)) == 2, "said once a minute"
