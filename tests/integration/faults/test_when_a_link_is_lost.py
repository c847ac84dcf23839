"""docs/failures.md: a tracking worker dies (cable). A partition costs the steps it lasted."""

import time
from collections.abc import Iterator

import msgspec
import pytest

from process_runtime.settings import WorkerSettings
from process_runtime.supervisor import python_module
from tests.integration.conftest import StartProcess
from tests.integration.faults.asking import asked_all_along
from tests.integration.faults.other_machine import OtherMachine, free_port, other_machine
from tests.integration.faults.system import IMPATIENT, System, system
from tests.integration.waiting import stretched_s, wait_until

FAR = ("far-0", "far-1")


@pytest.fixture
def machine() -> Iterator[OtherMachine]:
    with other_machine() as made:
        yield made


def workers_of(tested: System) -> dict[str, tuple[str, ...]]:
    with tested.client as client:
        return dict(client.status().workers)


def test_a_partition_of_ten_seconds_costs_the_steps_it_lasted_and_nothing_else(
    machine: OtherMachine, start_process: StartProcess
) -> None:
    endpoint = f"tcp/{machine.address_here}:{free_port(machine.address_here)}"
    settings = msgspec.structs.replace(IMPATIENT, worker=WorkerSettings(count=3))
    with system(settings, endpoint=endpoint) as tested, asked_all_along(tested) as longest_s:
        file = tested.folder / "settings.toml"
        far = start_process(
            machine.command(
                python_module("worker", "--settings", str(file), "--name", "far", "--count", "2")
            )
        )
        wait_until(lambda: set(FAR) <= set(workers_of(tested)))
        tested.wait_until_it_tracks()
        wait_until(lambda: any(workers_of(tested)[name] for name in FAR))
        clusters, step_before = tested.clusters(), tested.step
        machine.pull_the_cable()
        cut_s = time.monotonic()

        wait_until(lambda: not set(FAR) & set(workers_of(tested)))
        assert time.monotonic() - cut_s < stretched_s(4.0), (
            "a node that says nothing for 2 s is gone"
        )
        step = tested.step
        wait_until(lambda: len(tested.since(step)) > 8 and tested.tracks())
        assert tested.clusters() == clusters, "standby workers have taken over"
        while time.monotonic() < cut_s + 10.0:  # the partition itself
            tested.wait_for_steps(1)
        assert not any(belief.missing for belief in tested.since(step + 8))
        assert longest_s() < stretched_s(3.0), "this side has its links, and is answered"
        machine.plug_it_in_again()
        plugged_s = time.monotonic()
        wait_until(lambda: set(FAR) <= set(workers_of(tested)))
        assert time.monotonic() - plugged_s < stretched_s(3.0), "a second between tries to connect"
        tested.wait_for_steps(10)
        assert tested.clusters() == clusters
        assert far.is_running()
        steps = [belief.step for belief in tested.since(step_before)]
        assert steps == sorted(set(steps)), "none was decided twice"
        for belief in tested.since(step_before):
            here = sum(h.probability for h in belief.hypotheses)
            assert here + belief.elsewhere_probability == pytest.approx(1.0)
        with tested.client as client:
            assert client.status().steps_lost == 0
