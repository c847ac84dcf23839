"""docs/results.md: workers start as the belief widens and end as it narrows; no update is lost."""

import os
import signal
from collections.abc import Iterator, Sequence
from pathlib import Path

import psutil
import pytest
from msgspec.structs import replace

import clustermcl.commands.stack
from clustermcl.commands.stack import WORKERS
from clustermcl.runtime.settings import WorkerSettings
from clustermcl.runtime.supervisor import python_module
from tests.integration.faults.system import SMALL, System, system
from tests.integration.processes import python_script
from tests.integration.waiting import wait_until

FOUR_CORES = Path(__file__).parent / "programs" / "workers_on_four_cores.py"
WIDE, NARROW = 4, 2
"""Workers for four clusters and a look elsewhere, and for one cluster and a look elsewhere."""
NEAR_M = 0.5


@pytest.fixture
def by_need(monkeypatch: pytest.MonkeyPatch) -> Iterator[System]:
    def command(module: str, *arguments: str) -> Sequence[str]:
        if module == "clustermcl.worker":
            return python_script(FOUR_CORES, *arguments)
        return python_module(module, *arguments)

    monkeypatch.setattr(clustermcl.commands.stack, "python_module", command)
    with system(replace(SMALL, worker=WorkerSettings())) as tested:
        yield tested


def busy_worker(tested: System) -> int:
    name = next(name for name, jobs in tested.jobs().items() if jobs)
    children = psutil.Process(tested.pid(WORKERS)).children()
    return next(child.pid for child in children if child.name() == name)


def kill_one(tested: System, count: int) -> None:
    """Kill a busy worker; as many as before are there again, and no update is lost."""
    step, clusters = tested.step, tested.clusters()
    os.kill(busy_worker(tested), signal.SIGKILL)
    tested.wait_for_steps(10)
    wait_until(lambda: len(tested.jobs()) == count)
    assert tested.clusters() == clusters
    assert not any(belief.missing for belief in tested.since(step)), "no update was lost"


def test_workers_follow_the_number_of_clusters_and_a_kill_in_each_phase_loses_nothing(
    by_need: System,
) -> None:
    tested = by_need
    tested.wait_until_it_tracks()
    wait_until(lambda: len(tested.jobs()) == WIDE)
    assert len(tested.clusters()) == WIDE
    first = tested.step
    kill_one(tested, WIDE)

    pose = tested.pose().pose
    assert pose is not None
    with tested.client as client:
        client.relocalize(near=(*pose[:2], NEAR_M))
    wait_until(lambda: len(tested.jobs()) == NARROW)
    assert len(tested.clusters()) == 1
    kill_one(tested, NARROW)

    step = tested.step
    with tested.client as client:
        client.relocalize()
    wait_until(lambda: tested.step > step + 2 and len(tested.jobs()) > NARROW)
    os.kill(busy_worker(tested), signal.SIGKILL)
    wait_until(lambda: len(tested.jobs()) == WIDE and tested.tracks())
    assert len(tested.clusters()) == WIDE
    assert not any(belief.missing for belief in tested.since(first)), "no update was lost"
