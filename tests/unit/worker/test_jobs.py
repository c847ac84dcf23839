import numpy as np
import pytest
from msgspec.structs import replace

from clustermcl.filter.cluster.cluster_filter import ParticleSet
from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.filter.settings import ClusterSettings, FilterSettings
from clustermcl.jobs.jobs import RunningJob, Tracking, running
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.pose_arrays import covariance_tuple, pose_tuple
from clustermcl.protocol.steps import mirrored
from clustermcl.protocol.work import Assignment, Particles, SearchJob, TrackReport
from tests.unit.worker.test_job_table import SETTINGS, cloud, model, scan, track

__all__ = ["model"]  # the fixture


KEPT = replace(SETTINGS, cluster=ClusterSettings(particles=100, resample_below_ess=0.001))
"""Nothing is redrawn."""


def particles_of(job: RunningJob) -> Particles:
    handed = job.handed_on().job
    assert not isinstance(handed, SearchJob)
    return handed.start


def begun(
    job_id: str, sensors: SensorModel, settings: FilterSettings = SETTINGS, *, exact: bool = False
) -> RunningJob:
    return running(track(job_id, cloud(), exact=exact), sensors, settings, sender="w")


def poses_of(job: RunningJob) -> np.ndarray:
    return particles_of(job).map_from_robot.array()


def test_clusters_do_not_share_the_noise_of_their_start(model: SensorModel) -> None:
    jobs = [begun(job_id, model, exact=False) for job_id in ("c0", "c1")]
    first, second = (vars(job)["_particle_set"].map_from_robot for job in jobs)
    assert not np.intersect1d(first, second).size


def test_a_cluster_without_a_scan_is_handed_on_unchanged(model: SensorModel) -> None:
    """Whoever begins it draws the same particles, and takes its first scan as the first."""
    job = begun("c0", model)
    assert job.handed_on() == job.assignment
    again = running(job.handed_on(), model, SETTINGS, sender="v")
    first, second = (vars(one)["_particle_set"].map_from_robot for one in (job, again))
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize(
    ("job_id", "seed"), [("c1", 0), ("c0", 1)], ids=["another cluster", "another seed"]
)
def test_clusters_and_seeds_do_not_share_their_noise(
    model: SensorModel, job_id: str, seed: int
) -> None:
    """From one start, at one step: else what errs for one errs for all alike."""
    jobs = [
        begun("c0", model, KEPT, exact=True),
        begun(job_id, model, replace(KEPT, seed=seed), exact=True),
    ]
    for job in jobs:
        job.advance(scan(1))
    assert not np.intersect1d(*(poses_of(job) for job in jobs)).size


def test_steps_do_not_share_their_noise(model: SensorModel) -> None:
    job = begun("c0", model, KEPT, exact=True)
    headings = [poses_of(job)[:, 2]]
    for step in (1, 2):
        job.advance(scan(step))
        headings.append(poses_of(job)[:, 2])
    first, second = np.diff(headings, axis=0)
    assert np.abs(first - second).min() > 1e-9


@pytest.mark.parametrize(("last", "reversed_by_scans"), [(0, 0.5), (-1, 0.0)])
def test_half_of_the_particles_move_by_scans_that_contradict_odometry(
    model: SensorModel, last: int, reversed_by_scans: float
) -> None:
    """But not by those of one step only, where the step before was missed."""
    assignment = track("c0", cloud(last), exact=True)
    job = running(assignment, model, KEPT, sender="w")
    before = poses_of(job)[:, 0]
    job.advance(replace(scan(1), motion_by_scans=(-0.3, 0.0, 0.0)))
    assert np.mean(poses_of(job)[:, 0] < before) == reversed_by_scans


def test_a_report_describes_the_current_particles(model: SensorModel) -> None:
    job = begun("c0", model)
    report = [job.advance(scan(step)) for step in (1, 2, 3)][-1]
    particles = particles_of(job)
    now = ParticleSet(particles.map_from_robot.array(), particles.log_weights.array())
    mean, covariance = now.gaussian()
    assert report.pose == pose_tuple(mean)
    assert report.covariance == covariance_tuple(covariance)
    assert report.particles == len(now.log_weights) == 100
    assert report.effective_sample_size == pytest.approx(now.effective_sample_size)
    assert (report.step, particles.step) == (3, 3)
    assert particles.odom_from_robot == scan(3).odom_from_robot


def sizes(job: RunningJob, steps: range) -> list[int]:
    return [job.advance(scan(step)).particles for step in steps]


ALWAYS = replace(SETTINGS, cluster=ClusterSettings(particles=100, resample_below_ess=1.0))
"""Each step resamples."""


@pytest.mark.parametrize("other", [25, 400])
def test_another_number_of_particles_holds_from_its_step_on_also_of_a_cluster_handed_over(
    model: SensorModel, other: int
) -> None:
    job = begun("c0", model, ALWAYS)
    assert isinstance(job, Tracking)
    job.size = other, 5
    sizes(job, range(1, 4))
    again = running(job.handed_on(), model, ALWAYS, sender="v")
    assert sizes(job, range(4, 8)) == sizes(again, range(4, 8)) == [100, other, other, other]
    np.testing.assert_array_equal(poses_of(job), poses_of(again))


def test_a_handed_over_place_is_drawn_by_its_weights(model: SensorModel) -> None:
    poses = np.repeat([[2.0, 3.0, 0.0], [6.0, 3.0, 0.0]], 25, axis=0)
    start = replace(
        cloud(),
        map_from_robot=ArrayBlob.of(poses, "float64"),
        log_weights=ArrayBlob.of(np.repeat([0.0, -40.0], 25), "float64"),
    )
    job = running(track("c0", start), model, SETTINGS, sender="w")
    report = job.advance(scan(1))
    assert report.pose[0] == pytest.approx(2.2, abs=0.2)


def test_each_cluster_reports_particles_at_its_own_steps(model: SensorModel) -> None:
    reported = {}
    for job_id in ("c0", "c1"):
        job = running(track(job_id, cloud()), model, SETTINGS, sender="w", snapshot_every_steps=3)
        reports = [job.advance(scan(step)) for step in range(1, 7)]
        reported[job_id] = [report.step for report in reports if report.snapshot]
    assert reported == {"c0": [3, 6], "c1": [1, 4]}


def test_shards_begin_apart_and_share_the_poses(model: SensorModel) -> None:
    found = []
    for shard in range(2):
        order = Assignment(job_id=f"s0.{shard}", epoch=0, job=SearchJob(search=0, shard=shard,
                           first_step=5))  # fmt: skip
        job = running(order, model, SETTINGS, sender="w")
        assert job.step == 4
        reports = [job.advance(scan(step)) for step in (5, 6, 7)]
        found.append(reports)
    first, second = found
    assert [report.particles for report in first] == [100, 100, 100]
    assert [bool(report.places) for report in first] == [True, True, True]  # type: ignore[union-attr]
    assert first[0].log_evidence != second[0].log_evidence  # type: ignore[union-attr]


def test_a_mirrored_job_reports_as_a_plain_one_does_for_mirrored_scans(model: SensorModel) -> None:
    def made(*, is_mirrored: bool) -> RunningJob:
        plain = track("c0", cloud(), exact=True)
        job = replace(plain.job, mirrored=is_mirrored)
        return running(replace(plain, job=job), model, SETTINGS, sender="w")

    decoy, plain = made(is_mirrored=True), made(is_mirrored=False)
    for step in range(3, 6):
        seen = replace(scan(step), odom_from_robot=(0.1 * step, 0.02 * step, 0.1))
        found = decoy.advance(seen)
        assert isinstance(found, TrackReport)
        in_order = replace(found, fits=found.fits[::-1])  # its beams have the order of the scan's
        assert in_order == plain.advance(mirrored(seen))
    handed = decoy.handed_on()
    assert handed.job == replace(plain.handed_on().job, mirrored=True)
    again = running(handed, model, SETTINGS, sender="w")
    assert again.advance(scan(7)) == decoy.advance(scan(7))
