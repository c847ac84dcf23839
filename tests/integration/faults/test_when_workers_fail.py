"""docs/failures.md: workers die, hang, never report or flood; others continue their clusters.

`test_same_beliefs` shows that a cluster that moves keeps its particles; here are the times.
"""

import os
import signal
import time
from contextlib import suppress

import numpy as np
import psutil
import pytest
import zenoh
from msgspec.structs import replace

from clustermcl.belief.ensemble import ELSEWHERE
from clustermcl.client import Client
from clustermcl.commands.stack import COORDINATOR, WORKERS
from clustermcl.link.session import open_session
from clustermcl.protocol import keys
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.errors import RefusedError, UnreachableError
from clustermcl.protocol.work import Particles, Reported, TrackReport, reports_in
from clustermcl.runtime.settings import CoordinatorSettings, WorkerSettings
from clustermcl.runtime.stop import StopFlag
from tests.integration.faults.system import IMPATIENT, SIMULATOR, SMALL, System, system
from tests.integration.untrue_worker import UntrueWorker
from tests.integration.waiting import PATIENCE_S, stretched_s, wait_until
from tests.unit.coordinator.reports import particles

SIX_WORKERS = replace(SMALL, worker=WorkerSettings(count=6))
"""Four clusters, and a look elsewhere: one stands by."""
DEADLINE_S = 1.0
"""Below the lease of a link: afterwards another worker has the job, and no report is missing."""
LIARS = [f"aa-liar-{n}" for n in range(60)]
"""Before the honest ones by name."""
ASKED = 30
FLOOD, HUGE = 40, 24
PARTICLES = 1_000_000
"""The most that a message can carry: 32 MB."""


def signal_one_that_tracks(tested: System, number: int) -> tuple[str, str, int]:
    name, (job, *_) = next(
        (name, jobs) for name, jobs in tested.jobs().items() if set(jobs) - {ELSEWHERE}
    )
    pid = tested.worker_pids()[int(name.removeprefix("worker-"))]
    os.kill(pid, number)
    return name, job, pid


def test_the_cluster_of_a_killed_worker_is_on_a_standby_worker_within_a_second() -> None:
    with system(SIX_WORKERS) as tested:
        tested.wait_until_it_tracks()
        clusters, step, jobs = tested.clusters(), tested.step, tested.jobs().values()
        expected = {f"c{number}" for number in clusters} | {ELSEWHERE}
        assert {job for one in jobs for job in one} == expected
        assert set(map(len, jobs)) == {0, 1}, "some stand by"
        killed_s = time.monotonic()
        name, job, _ = signal_one_that_tracks(tested, signal.SIGKILL)
        wait_until(lambda: any(job in jobs for n, jobs in tested.jobs().items() if n != name))
        assert time.monotonic() - killed_s < stretched_s(1.0)
        wait_until(lambda: len(tested.since(step)) > 10)
        assert not any(belief.missing for belief in tested.since(step)), "no update was lost"
        assert tested.clusters() == clusters


def test_a_frozen_worker_delays_the_others_by_one_deadline_and_is_replaced() -> None:
    coordinator = CoordinatorSettings(step_deadline_s=DEADLINE_S)
    with system(replace(SIX_WORKERS, coordinator=coordinator)) as tested:
        tested.wait_until_it_tracks()
        tested.wait_for_steps(10)
        clusters, usual_s = tested.clusters(), max(tested.gaps_s()[-5:])
        received, step = len(tested.gaps_s()), tested.step
        name, job, pid = signal_one_that_tracks(tested, signal.SIGSTOP)
        try:
            wait_until(lambda: any(job in belief.missing for belief in tested.since(step)))
            wait_until(lambda: len(tested.since(step)) > 12 and tested.tracks())
            assert max(tested.gaps_s()[received:]) < usual_s + stretched_s(DEADLINE_S + 0.4)
            assert {job_id for belief in tested.since(step) for job_id in belief.missing} == {job}
            assert tested.clusters() == clusters
            assert tested.jobs().get(name, ()) == ()
        finally:
            os.kill(pid, signal.SIGCONT)
        wait_until(lambda: name in tested.jobs())
        assert tested.jobs()[name] == (), "it stands by"
        step = tested.step
        tested.wait_for_steps(10)
        assert not any(belief.missing for belief in tested.since(step))
        assert tested.clusters() == clusters
        assert_another_worker_advises(tested)


def assert_another_worker_advises(tested: System) -> None:
    """Of a silent worker, a client that waits 20 s got no answer."""
    tested.hurt(SIMULATOR, signal.SIGSTOP)  # no step shows who is silent
    silent = next(name for name, jobs in sorted(tested.jobs().items()) if jobs)
    held = list[zenoh.Query]()  # its link does not end
    queryable = tested.session.declare_queryable(keys.worker_advice(silent), held.append)
    pid = tested.worker_pids()[int(silent.removeprefix("worker-"))]
    os.kill(pid, signal.SIGSTOP)
    try:
        advisers = list[str]()

        def is_advised() -> bool:
            """Ask again: on a busy machine another one may be too slow, too."""
            with Client(tested.settings) as client, suppress(RefusedError, UnreachableError):
                advisers.append(client.advice().sender)
            return bool(advisers)

        wait_until(is_advised)
        assert advisers[0] not in ("coordinator", silent)
    finally:
        queryable.undeclare()
        os.kill(pid, signal.SIGCONT)
    assert held


def test_without_workers_status_and_pose_report_this_until_a_worker_appears() -> None:
    coordinator = CoordinatorSettings(stale_after_s=5.0)
    with system(replace(IMPATIENT, coordinator=coordinator)) as tested:
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


def test_sixty_names_that_never_report_stop_no_search_and_seldom_cause_dead_reckoning() -> None:
    coordinator = CoordinatorSettings(step_deadline_s=1.0, stale_after_s=5.0)
    with system(replace(IMPATIENT, coordinator=coordinator)) as tested, tested.client as client:
        tested.wait_until_it_tracks()
        zenoh_settings, robot = tested.settings.zenoh, tested.settings.robot
        with open_session(zenoh_settings, robot, StopFlag(), wait_s=PATIENCE_S) as session:
            _liars = [UntrueWorker(session, name) for name in LIARS]
            wait_until(lambda: client.pose().workers >= len(LIARS))
            step = tested.step
            client.relocalize()
            wait_until(lambda: tested.step > step + 5 and tested.tracks())
            reported = []
            for _ in range(ASKED):
                tested.wait_for_steps(1)
                reported.append(client.pose().freshness)
            assert reported.count("fresh") > 0.9 * ASKED
            assert max(len(belief.missing) for belief in tested.beliefs[-ASKED:]) <= 1


class Flooder:
    def __init__(self, tested: System) -> None:
        self._session = tested.session
        self._received: dict[str, TrackReport] = {}
        tested.session.declare_subscriber(keys.ALL_REPORTS, self._on_report)
        wait_until(lambda: self._received)
        self._key = min(self._received)

    def _on_report(self, sample: zenoh.Sample) -> None:
        message: Reported = decode(sample.payload.to_bytes(), Reported)  # type: ignore[arg-type] # a union
        for report in reports_in(message):
            if isinstance(report, TrackReport):
                self._received[str(sample.key_expr)] = report

    def report(self, step: int, snapshot: Particles | None = None) -> None:
        report = replace(self._received[self._key], step=step, snapshot=snapshot)
        block = zenoh.CongestionControl.BLOCK
        self._session.put(self._key, encode(report), congestion_control=block)


def resident_mb(tested: System) -> float:
    return float(psutil.Process(tested.pid(COORDINATOR)).memory_info().rss) / 1e6


def test_reports_of_steps_far_ahead_and_huge_snapshots_are_refused_and_not_kept() -> None:
    with system() as tested, tested.client as client:

        def counter(name: str) -> int:
            return client.status().counters.get(name, 0)

        tested.wait_until_it_tracks()
        flooder, before_mb = Flooder(tested), resident_mb(tested)
        huge = particles(np.zeros((PARTICLES, 3)))
        for n in range(HUGE):
            step = (tested.step if n % 2 else 1_000_000) + n
            flooder.report(step, replace(huge, step=step))
        wait_until(lambda: counter("snapshot with too many particles") > 0)

        def are_refused() -> bool:
            """Publish them again, for an inbox drops what comes faster than it is read."""
            for n in range(FLOOD):
                flooder.report(2_000_000 + n)
            return counter("report far ahead, or too many wait") >= FLOOD

        wait_until(are_refused)
        wait_until(lambda: resident_mb(tested) - before_mb < 300.0)
        step = tested.step
        wait_until(lambda: tested.step > step + 10 and tested.tracks())
