import os
import signal
from functools import partial
from itertools import groupby
from pathlib import Path

import msgspec
import psutil
import pytest

from coordinator.belief.outcome import Outcome
from protocol.answers import Belief
from tests.integration.system.conftest import SMALL, StartStack
from tests.integration.system.listening import beliefs_of, outcomes_of

STEPS = 60


@pytest.fixture(scope="module")
def alone() -> list[Outcome]:
    return outcomes_of(SMALL, steps=STEPS)


def assert_same(received: list[Belief], outcomes: list[Outcome]) -> None:
    """Compare the beliefs of processes, some of which a busy machine repeats, with those of one."""
    beliefs = [next(same) for _, same in groupby(received, lambda belief: belief.step)]
    assert [belief.step for belief in beliefs] == list(range(STEPS))
    for belief, outcome in zip(beliefs, outcomes, strict=True):
        assert belief.missing == (), f"step {belief.step}"
        assert belief.hypotheses == outcome.hypotheses, f"step {belief.step}"
        assert belief.state == outcome.state, f"step {belief.step}"
        assert belief.off_map_probability == outcome.off_map_probability, f"step {belief.step}"


def test_a_decoy_changes_the_belief_in_processes_as_it_does_in_one(start_stack: StartStack) -> None:
    """A robot that is probably not on the map has one at once; it is searched for and tracked."""
    belief = msgspec.structs.replace(SMALL.belief, off_map_probability=0.6)
    doubting = msgspec.structs.replace(SMALL, belief=belief)
    alone = outcomes_of(doubting, steps=STEPS)
    jobs = {job_id for outcome in alone for job_id in outcome.begin}
    assert {"m0.0", "d0"} <= jobs
    stack, settings = start_stack(doubting, steps=STEPS)
    assert_same(beliefs_of(stack, settings), alone)


def test_workers_that_are_killed_change_no_belief(
    start_stack: StartStack, alone: list[Outcome]
) -> None:
    """One is killed, then two, then all: their clusters continue from snapshots, bit for bit."""
    stack, settings = start_stack(SMALL, steps=STEPS)

    def kill(count: int) -> None:
        folder = Path(settings.zenoh.router.removeprefix("unixsock-stream/")).parent
        parents = [
            process
            for process in psutil.Process().children()
            if str(folder / "settings.toml") in process.cmdline() and "worker" in process.cmdline()
        ]
        (parent,) = parents
        for child in parent.children()[:count]:
            os.kill(child.pid, signal.SIGKILL)

    beliefs = beliefs_of(
        stack, settings, at_step={15: partial(kill, 1), 27: partial(kill, 2), 41: partial(kill, 4)}
    )
    assert_same(beliefs, alone)
