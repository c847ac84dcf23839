"""Workers and coordinators are killed, and a replay of the recording gives the beliefs."""

import os
import shutil
import signal
from itertools import groupby, pairwise
from pathlib import Path

from msgspec.structs import replace

from clustermcl.commands.stack import COORDINATOR
from clustermcl.coordinator.recorder.records import Happened
from clustermcl.coordinator.recorder.replay import Believed, CoordinatorActs, replayed
from clustermcl.protocol.answers import Belief
from clustermcl.runtime.settings import RecorderSettings
from clustermcl.runtime.version import VERSION
from tests.integration.faults.live_robot import with_live_robot
from tests.integration.faults.system import SMALL
from tests.integration.system.commands import ran
from tests.integration.waiting import stretched_s, wait_until

LOST_S, STEPS_PER_S = 0.5, 10.0
"""A kill -9 loses the beliefs of this time, which wait for the disk; here some five a second."""


def assert_same(published: list[Belief], computed: list[Belief]) -> None:
    """All received beliefs of each term are replayed, except those not yet on disk at the end."""
    last_term = max(belief.term for belief in published)
    for term, beliefs in groupby(published, key=lambda belief: belief.term):
        of_term = [belief for belief in computed if belief.term == term]
        missing = [belief.step for belief in beliefs if belief not in of_term]
        assert missing == [step for step in missing if step > of_term[-1].step], "in the middle"
        assert len(missing) <= (0 if term == last_term else most_lost())


def most_lost() -> float:
    return STEPS_PER_S * stretched_s(LOST_S)


def repeated(computed: list[Belief]) -> list[int]:
    """So many steps before the last of the term before each later term's first belief is.

    It takes over at its start or, without a worker then, when the first one appears.
    """
    terms = [list(beliefs) for _, beliefs in groupby(computed, key=lambda belief: belief.term)]
    return [before[-1].step - after[0].step for before, after in pairwise(terms)]


def test_a_flight_recording_with_killed_processes_is_replayed_bit_for_bit(tmp_path: Path) -> None:
    folder, copy = tmp_path / "flight" / "robot", tmp_path / "copy"
    recorder = RecorderSettings(folder=str(tmp_path / "flight"), max_mb=5.0)
    with with_live_robot(replace(SMALL, recorder=recorder)) as (tested, _robot):
        tested.wait_until_it_tracks()
        killed = tested.worker_pids()[0]
        os.kill(killed, signal.SIGKILL)
        wait_until(lambda: len(tested.worker_pids()) == 4 and killed not in tested.worker_pids())
        tested.wait_for_steps(10)
        tested.restart(COORDINATOR)
        tested.wait_for_steps(10)
        with tested.client as client:
            client.set_pose((1.5, 1.5, 0.5))
        tested.wait_for_steps(5)
        shutil.copytree(folder, copy)
        tested.restart(COORDINATOR)
        tested.wait_for_steps(5)
    published = list(tested.beliefs)
    assert len({belief.term for belief in published}) == 3

    done = ran("replay", str(folder))
    assert (done.stderr, done.returncode) == ("", 0)
    assert done.stdout.splitlines()[-1].endswith("all as recorded, bit for bit")
    happenings = [each for _, each in replayed(folder, VERSION)]
    computed = [each.belief for each in happenings if isinstance(each, Believed)]
    assert_same(published, computed)
    acts = [each for each in happenings if isinstance(each, CoordinatorActs)]
    assert [each.term for each in acts] == sorted({belief.term for belief in published})
    assert acts[0].after_step is None
    assert all(abs(late) <= most_lost() for late in repeated(computed)), "each carries on"
    kinds = {each.kind for each in happenings if isinstance(each, Happened)}
    assert {"worker joined", "worker left", "pose given"} <= kinds

    while_it_ran = ran("replay", str(copy))
    assert while_it_ran.returncode == 0
    assert while_it_ran.stdout.splitlines()[-1].endswith("all as recorded, bit for bit")
