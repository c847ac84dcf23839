"""Workers and coordinators are killed, and a replay of the recording gives the beliefs."""

import os
import shutil
import signal
from pathlib import Path

from msgspec.structs import replace

from clustermcl.commands.stack import COORDINATOR
from clustermcl.coordinator.recorder.records import Happened
from clustermcl.coordinator.recorder.replay import Believed, CoordinatorActs, replayed
from clustermcl.runtime.settings import RecorderSettings
from clustermcl.runtime.version import VERSION
from tests.integration.faults.live_robot import with_live_robot
from tests.integration.faults.system import SMALL
from tests.integration.system.commands import ran
from tests.integration.waiting import stretched_s, wait_until

LOST_S, STEPS_PER_S = 0.5, 10.0
"""A kill -9 loses the beliefs of this time, which wait for the disk; here some five a second."""


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
    lost = [belief for belief in published if belief not in computed]
    assert len(lost) <= STEPS_PER_S * stretched_s(2 * LOST_S), "not yet on disk at two kills"
    acts = [each for each in happenings if isinstance(each, CoordinatorActs)]
    assert [each.term for each in acts] == sorted({belief.term for belief in published})
    assert acts[0].after_step is None
    kinds = {each.kind for each in happenings if isinstance(each, Happened)}
    assert {"worker joined", "worker left", "pose given"} <= kinds

    while_it_ran = ran("replay", str(copy))
    assert while_it_ran.returncode == 0
    assert while_it_ran.stdout.splitlines()[-1].endswith("all as recorded, bit for bit")
