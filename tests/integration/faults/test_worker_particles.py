"""Workers die: their clusters go on elsewhere with the very same particles."""

import os
import signal
from collections import defaultdict

import numpy as np
import zenoh

from coordinator.belief.ensemble import Ensemble
from coordinator.belief.outcome import Job
from coordinator.process import filter_settings
from particle_filter.arrays import Pose
from particle_filter.poses import between
from process_runtime.settings import Settings
from protocol import keys
from protocol.codec import decode
from protocol.work import Assignment, Report, TrackReport
from robot_simulator.simulation import Simulation
from robot_simulator.source import SimulatedSource, simulated_steps
from tests.integration.faults.system import System, system
from tests.integration.faults.test_coordinator_dies import LOCKSTEP, STEPS
from tests.integration.waiting import wait_until
from tests.integration.worlds import world_of
from worker.jobs import RunningJob, running
from worker.map_model import sensor_model

Snapshots = dict[tuple[str, int], set[bytes]]
"""Particles of a job after a step, by the reporting worker."""


def told(report: Report, snapshots: Snapshots) -> None:
    if isinstance(report, TrackReport) and report.snapshot is not None:
        particles = report.snapshot
        blob = particles.map_from_robot.data + particles.log_weights.data
        snapshots[report.job_id, report.step].add(blob)


def undisturbed(settings: Settings) -> Snapshots:
    """The result of one process without a network."""
    world = world_of(settings)
    source = SimulatedSource(Simulation(world, settings.seed), steps=STEPS)
    plain = filter_settings(settings)
    model = sensor_model(world.map, settings.sensor, cache_folder=None)
    every = settings.coordinator.snapshot_every_steps
    ensemble, snapshots = Ensemble.of(plain), defaultdict[tuple[str, int], set[bytes]](set)
    jobs: dict[str, RunningJob] = {}

    def begin(begun: dict[str, Job]) -> None:
        for job_id, job in begun.items():
            given = Assignment(job_id=job_id, epoch=0, job=job)
            jobs[job_id] = running(given, model, plain, sender="", snapshot_every_steps=every)

    before: Pose | None = None
    for scan, _ in simulated_steps(source, settings.bridge, world.map.digest):
        after = np.array(scan.odom_from_robot)
        moved, before = None if before is None else between(before, after), after
        if not ensemble.searches:
            begin(ensemble.begin_at(scan.step))
        reports = [jobs[job_id].advance(scan) for job_id in sorted(jobs)]
        for report in reports:
            told(report, snapshots)
        outcome = ensemble.advance(scan.step, reports, moved)
        for job_id in outcome.end:
            del jobs[job_id]
        begin(outcome.begin)
    return snapshots


def heard(tested: System) -> Snapshots:
    """The workers' reports from now on."""
    snapshots = defaultdict[tuple[str, int], set[bytes]](set)

    def on_report(sample: zenoh.Sample) -> None:
        report: Report = decode(sample.payload.to_bytes(), Report)  # type: ignore[arg-type] # a union
        told(report, snapshots)

    tested.session.declare_subscriber(keys.ALL_REPORTS, on_report)
    return snapshots


def test_every_worker_that_tracks_a_cluster_has_the_same_particles() -> None:
    """One worker is killed, then two, then all at once: no standby is left."""
    with system(LOCKSTEP, "--steps", str(STEPS)) as tested:
        snapshots = heard(tested)
        for step, count in ((15, 1), (27, 2), (41, 4)):
            wait_until(lambda s=step: tested.step >= s)  # type: ignore[misc] # a default
            for pid in tested.worker_pids()[:count]:
                os.kill(pid, signal.SIGKILL)
        wait_until(lambda: bool(tested.beliefs) and tested.beliefs[-1].last)
        assert all(belief.missing == () for belief in tested.beliefs), "no update was lost"
        steps = [belief.step for belief in tested.beliefs]
        assert steps == sorted(set(steps)), "and none was counted twice"
    assert_same(snapshots, after=41)


def assert_same(snapshots: Snapshots, *, after: int) -> None:
    """All received particles equal those of one process, also after the last kill."""
    expected = undisturbed(LOCKSTEP)
    assert len([step for _, step in snapshots if step > after]) >= 4
    for (job, step), particles in snapshots.items():
        assert particles == expected[job, step], f"{job} after step {step}"
