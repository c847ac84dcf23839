"""docs/failures.md: a tracking worker dies: its cluster goes on elsewhere, untouched.

That its particles are bit-identical then, `test_same_beliefs` shows; here it is the time it takes.
"""

import os
import signal
import time

import msgspec

from coordinator.belief.ensemble import ELSEWHERE
from process_runtime.settings import WorkerSettings
from tests.integration.faults.system import SMALL, system
from tests.integration.waiting import stretched_s, wait_until

SIX_WORKERS = msgspec.structs.replace(SMALL, worker=WorkerSettings(count=6))
"""Four clusters, and a look elsewhere: one stands by."""


def test_the_cluster_of_a_killed_worker_is_on_a_standby_worker_within_a_second() -> None:
    with system(SIX_WORKERS) as tested, tested.client as client:
        tested.wait_until_it_tracks()
        clusters, step = tested.clusters(), tested.step
        workers = client.status().workers
        jobs_of_all = {job for jobs in workers.values() for job in jobs}
        assert jobs_of_all == {f"c{number}" for number in clusters} | {ELSEWHERE}
        assert set(map(len, workers.values())) == {0, 1}, "some stand by"
        name = next(name for name, jobs in workers.items() if set(jobs) - {ELSEWHERE})
        (job,) = workers[name]
        os.kill(tested.worker_pids()[int(name.removeprefix("worker-"))], signal.SIGKILL)
        killed_s = time.monotonic()

        def is_elsewhere() -> bool:
            return any(job in jobs for n, jobs in client.status().workers.items() if n != name)

        wait_until(is_elsewhere)
        assert time.monotonic() - killed_s < stretched_s(1.0)
        wait_until(lambda: len(tested.since(step)) > 10)
        assert not any(belief.missing for belief in tested.since(step)), "no update was lost"
        assert tested.clusters() == clusters
