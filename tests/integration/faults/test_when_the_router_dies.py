"""docs/failures.md: a restarted router costs the steps it lasted, and nothing else."""

import time

from clustermcl.commands.stack import COORDINATOR, ROUTER, WORKERS
from tests.integration.faults.system import SIMULATOR, system
from tests.integration.waiting import stretched_s, wait_until

OUTAGE_S = 2.5
"""Longer than the lease of 2 s."""


def test_a_restart_of_the_router_loses_only_the_steps_made_meanwhile() -> None:
    with system() as tested:
        tested.wait_until_it_tracks()
        placed, clusters = tested.jobs(), tested.clusters()
        pids, workers = dict(tested.stack.supervisor.pids()), tested.worker_pids()
        tested.hurt(ROUTER)
        time.sleep(OUTAGE_S)
        last_before = tested.step
        tested.mend()
        mended_s = time.monotonic()
        wait_until(lambda: tested.step > last_before)
        assert time.monotonic() - mended_s < stretched_s(2.5), "to connect, and to decide"
        tested.wait_for_steps(10)
        assert tested.clusters() == clusters
        assert tested.jobs() == placed, "no cluster was moved"
        assert tested.worker_pids() == workers
        for name in (COORDINATOR, WORKERS, SIMULATOR):
            assert tested.pid(name) == pids[name], f"{name} went on"
        # The simulated robot waits for a coordinator, so even the steps of the outage are there.
        after = tested.since(last_before)
        assert [belief.missing for belief in after] == [()] * len(after)
        assert tested.status().steps_lost == 0
