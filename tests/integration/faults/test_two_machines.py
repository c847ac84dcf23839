"""Half of the workers on another machine, and the cable between fails in every way it can."""

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import NamedTuple

import pytest
from msgspec.structs import replace

from clustermcl.commands.stack import COORDINATOR
from clustermcl.protocol.answers import PoseAnswer
from clustermcl.runtime.settings import WorkerSettings
from clustermcl.runtime.supervisor import python_module
from tests.integration.faults.system import IMPATIENT, System, system
from tests.integration.faults.two_machines import Cable, second_machine
from tests.integration.free_port import free_port
from tests.integration.processes import RunningProcess
from tests.integration.waiting import stretched_s, wait_until

NEAR, FAR = 2, 2
ASKED_EVERY_S = 0.05
CUT_S = 12.0
"""The lease of a dead link (2 s) plus the time that its close may block (10 s)."""
SETTINGS = replace(IMPATIENT, worker=WorkerSettings(count=NEAR))


class TwoMachines(NamedTuple):
    system: System
    cable: Cable

    def is_whole(self) -> bool:
        """Whether all workers are there, and every cluster is reported on."""
        return len(self.system.jobs()) == NEAR + FAR and self.system.tracks()

    def goes_on(self, after_term: int, after_step: int) -> bool:
        """Whether another coordinator publishes later steps; dead processes are restarted."""
        self.system.stack.supervisor.poll(time.monotonic())
        last = self.system.beliefs[-1]
        return last.term > after_term and last.step >= after_step + 5

    def answers(self, seconds: float) -> list[PoseAnswer]:
        """Query the pose from the robot's own machine for this time [s]."""
        answers, longest_s, until_s = [], 0.0, time.monotonic() + seconds
        with self.system.client as client:
            while (asked_s := time.monotonic()) < until_s:
                answers.append(client.pose())
                longest_s = max(longest_s, time.monotonic() - asked_s)
                time.sleep(ASKED_EVERY_S)
        assert longest_s < stretched_s(3.0), "links that still work are served"
        return answers


@pytest.fixture(scope="module")
def machines() -> Iterator[TwoMachines]:
    with second_machine() as cable:
        endpoint = f"tcp/{cable.here}:{free_port()}"
        with system(SETTINGS, endpoint=endpoint) as tested:
            words = ["--settings", str(tested.folder / "settings.toml"), "--name", "far"]
            command = python_module("clustermcl.worker", *words, "--count", str(FAR))
            far = RunningProcess([*cable.over_there, *command], tested.folder, "far")
            try:
                both = TwoMachines(tested, cable)
                wait_until(both.is_whole)
                yield both
            finally:
                far.kill()


def held(machines: TwoMachines, fault: AbstractContextManager[None], seconds: float) -> None:
    """The robot's pose is answered and follows it all along, and then everything is whole again.

    It may be dead reckoning for a moment: a cluster that is just being handed over is waited for.
    """
    clusters = machines.system.clusters()
    with fault:
        answers = machines.answers(seconds)
    assert answers
    assert {answer.freshness for answer in answers} <= {"fresh", "dead_reckoning"}
    assert answers[-1].step > answers[0].step, "steps are believed meanwhile"
    step = machines.system.step
    wait_until(lambda: machines.system.step >= step + 5 and machines.is_whole())
    assert machines.system.clusters() == clusters, "other workers have taken over"


@pytest.mark.parametrize(
    ("from_here", "from_there"), [(True, False), (False, True)],
    ids=["to the far machine", "from the far machine"],
)  # fmt: skip
def test_a_cable_that_is_cut_one_way_costs_the_robot_no_answer(
    machines: TwoMachines, from_here: bool, from_there: bool
) -> None:
    held(machines, machines.cable.cut(from_here=from_here, from_there=from_there), CUT_S)


@pytest.mark.parametrize(
    "how",
    [
        pytest.param("tbf rate 1mbit burst 16kb latency 200ms", id="1 Mbit/s"),
        pytest.param("netem delay 50ms 20ms", id="50 ms +- 20 ms"),
        pytest.param("netem loss 5%", id="5 % lost"),
        pytest.param("netem delay 20ms reorder 25% 50%", id="reordered"),
    ],
)
def test_a_bad_cable_costs_the_robot_no_answer(machines: TwoMachines, how: str) -> None:
    held(machines, machines.cable.shaped(*how.split()), 5.0)


def test_a_new_coordinator_continues_after_the_old_one_dies_while_the_cable_is_cut(
    machines: TwoMachines,
) -> None:
    with machines.cable.cut(from_here=True, from_there=True):
        term, step = machines.system.beliefs[-1].term, machines.system.step
        machines.system.hurt(COORDINATOR)
        wait_until(lambda: machines.goes_on(term, step))
    wait_until(machines.is_whole)
