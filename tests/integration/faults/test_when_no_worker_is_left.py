"""docs/failures.md: no worker is left: status and pose say so; one that appears takes over."""

import os
import signal

import msgspec
import pytest

from clustermcl.stack import WORKERS
from process_runtime.settings import CoordinatorSettings
from tests.integration.faults.system import IMPATIENT, system
from tests.integration.waiting import wait_until

BELIEF = msgspec.structs.replace(IMPATIENT.belief, transition_probability=0.0)
SETTINGS = msgspec.structs.replace(
    IMPATIENT, belief=BELIEF, coordinator=CoordinatorSettings(stale_after_s=5.0)
)
"""Nothing but evidence moves probabilities."""


def test_without_workers_status_and_pose_report_this_until_a_worker_appears() -> None:
    with system(SETTINGS) as tested:
        tested.wait_until_it_tracks()
        clusters = tested.clusters()
        tested.hurt(WORKERS, signal.SIGSTOP)  # their parent, so that it starts no others
        try:
            for pid in tested.worker_pids():
                os.kill(pid, signal.SIGKILL)
            with tested.client as client:
                wait_until(lambda: client.pose().workers == 0)
                assert client.status().workers == {}
                step = tested.step
                wait_until(lambda: len(tested.since(step)) >= 4)
                without = tested.since(step)[-2:]
                assert all(len(belief.missing) == 5 for belief in without), "and elsewhere"
                first, second = (
                    {h.cluster: h.probability for h in belief.hypotheses} for belief in without
                )
                assert first == pytest.approx(second), "no evidence, no change"
                pose = client.pose()
                assert pose.freshness == "dead_reckoning", "odometry alone carries the pose on"
                assert pose.age_s < pose.scan_age_s
        finally:
            tested.hurt(WORKERS, signal.SIGCONT)
        with tested.client as client:
            wait_until(lambda: client.pose().workers == 4)
            step = tested.step
            wait_until(lambda: len(tested.since(step)) > 5 and tested.tracks())
        assert tested.clusters() == clusters, "each goes on from its last state"
