"""docs/failures.md: a slow worker is left behind and then replaced; it never slows others."""

import contextlib
import os
import signal
from collections.abc import Iterator

import msgspec
import pytest

from process_runtime.settings import CoordinatorSettings, WorkerSettings
from tests.integration.faults.system import SMALL, System, system
from tests.integration.waiting import stretched_s, wait_until

DEADLINE_S = 1.0
"""Below the lease of a link: afterwards another worker has the job, and no report is missing."""
SETTINGS = msgspec.structs.replace(
    SMALL,
    worker=WorkerSettings(count=6),
    coordinator=CoordinatorSettings(step_deadline_s=DEADLINE_S),
)
"""Four clusters, six workers: two stand by."""


@pytest.fixture
def frozen() -> Iterator[list[int]]:
    """Processes put here go on when the test ends, so that they can be ended."""
    pids: list[int] = []
    yield pids
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)


def workers_of(tested: System) -> dict[str, tuple[str, ...]]:
    with tested.client as client:
        return dict(client.status().workers)


def freeze_one_that_tracks(tested: System, frozen: list[int]) -> tuple[str, str]:
    """Its name, and the job that it has."""
    name = next(name for name, jobs in workers_of(tested).items() if jobs)
    (job,) = workers_of(tested)[name]
    pid = tested.worker_pids()[int(name.removeprefix("worker-"))]
    os.kill(pid, signal.SIGSTOP)
    frozen.append(pid)
    return name, job


def test_a_frozen_worker_delays_the_others_by_one_deadline_and_is_replaced(
    frozen: list[int],
) -> None:
    with system(SETTINGS) as tested:
        tested.wait_until_it_tracks()
        tested.wait_for_steps(10)
        clusters, usual_s = tested.clusters(), max(tested.gaps_s()[-5:])
        heard, step = len(tested.gaps_s()), tested.step
        name, job = freeze_one_that_tracks(tested, frozen)
        wait_until(lambda: any(job in belief.missing for belief in tested.since(step)))
        wait_until(lambda: len(tested.since(step)) > 12 and tested.tracks())
        assert max(tested.gaps_s()[heard:]) < usual_s + stretched_s(DEADLINE_S + 0.4)
        missed = [belief for belief in tested.since(step) if belief.missing]
        assert {job_id for belief in missed for job_id in belief.missing} == {job}
        assert tested.clusters() == clusters
        assert workers_of(tested).get(name, ()) == ()

        os.kill(frozen[0], signal.SIGCONT)
        wait_until(lambda: name in workers_of(tested))
        assert workers_of(tested)[name] == (), "it stands by"
        step = tested.step
        tested.wait_for_steps(10)
        assert not any(belief.missing for belief in tested.since(step))
        assert tested.clusters() == clusters
