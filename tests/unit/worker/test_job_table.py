import numpy as np
import pytest
from msgspec.structs import replace

from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.filter.settings import ClusterSettings, FilterSettings, SearchSettings
from clustermcl.protocol import work
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.codec import encode
from clustermcl.protocol.steps import KEPT_STEPS, Scan
from clustermcl.worker.job_table import KEPT_SEARCH_STEPS, JobTable, RecentReports
from clustermcl.worker.search_queue import LONGEST_NS, SearchPause
from tests.unit.coordinator import reports
from tests.unit.filter.rooms import model_of, plain_room

SETTINGS = FilterSettings(
    cluster=ClusterSettings(particles=100),
    search=SearchSettings(heading_step_rad=0.1, poses=400, shards=2),
)


@pytest.fixture(scope="module")
def model() -> SensorModel:
    return model_of(plain_room(), SETTINGS.sensor)


def scan(step: int) -> Scan:
    ranges = ArrayBlob.of(np.linspace(1.0, 3.0, 31), "float32")
    return reports.scan(
        step, x_m=0.2 * step, stamp_ns=step, angle_min_rad=-1.5, range_max_m=20.0, ranges=ranges
    )


def cloud(step: int = 0) -> work.Particles:
    rng = np.random.default_rng(1)
    poses = np.array([2.0, 3.0, 0.0]) + rng.normal(0.0, 0.1, (50, 3))
    return reports.particles(poses, step=step, odom=(0.2 * step, 0.0, 0.0))


def track(
    job_id: str, start: work.Particles, *, epoch: int = 1, exact: bool = False
) -> work.Assignment:
    job = work.TrackJob(cluster=int(job_id[1:]), start=start, exact=exact)
    return work.Assignment(job_id=job_id, epoch=epoch, job=job)


def order(
    *begin: work.Assignment, keep: tuple[tuple[str, int], ...] = (), snapshots: int = 0
) -> work.WorkOrder:
    return reports.work_order(snapshot_every_steps=snapshots, keep=keep, begin=begin)


def search(shard: int = 0, first_step: int = 0) -> work.Assignment:
    job = work.SearchJob(search=0, shard=shard, first_step=first_step)
    return work.Assignment(job_id=f"s0.{shard}", epoch=1, job=job)


def table_with(model: SensorModel, *begun: work.Assignment) -> JobTable:
    table = JobTable("w")
    table.follow(order(*begun), model, SETTINGS)
    return table


def sizes(table: JobTable) -> list[tuple[int | None, int]]:
    jobs = [held.job for held in table.holds()]
    return [(job.particles, job.particles_from) for job in jobs if isinstance(job, work.TrackJob)]


def reports_of(table: JobTable, steps: range) -> list[work.TrackReport]:
    return [report for step in steps for report in table.on_scan(scan(step))]


def test_an_order_may_change_the_number_of_particles_of_a_job_that_is_kept(
    model: SensorModel,
) -> None:
    table = table_with(model, track("c0", cloud()), track("c1", cloud()))
    kept = replace(order(keep=(("c0", 1), ("c1", 1))), resize=(("c1", 25, 3), ("c9", 25, 3)))
    table.follow(kept, model, SETTINGS)
    as_given = [(None, -1), (None, -1)]
    assert sizes(table) == as_given, "they have seen no scan"
    reports_of(table, range(1, 2))
    assert sizes(table) == [(100, -1), (25, 3)]
    table.follow(order(track("c0", cloud())), model, SETTINGS)
    assert table.summary() == (("c0", 1, 1),), "a repeated order does not restart a job"


def test_a_missed_step_loses_only_its_own_evidence(model: SensorModel) -> None:
    table = table_with(model, track("c0", cloud()))
    table.on_scan(scan(1))
    (report,) = reports_of(table, range(5, 6))
    moved = report.pose[0] - np.mean(cloud().map_from_robot.array()[:, 0])
    assert moved == pytest.approx(1.0, abs=0.3), "five steps of 0.2 m, by odometry"


def searched(table: JobTable) -> list[work.Report]:
    reports: list[work.Report] = []
    while table.searches:
        reports += table.search_on()
    return reports


def test_slices_between_clusters_steps_change_nothing_of_what_a_search_finds(
    model: SensorModel,
) -> None:
    order_of_both = order(track("c0", cloud()), search(shard=1, first_step=1))
    at_once, in_slices = JobTable("w"), JobTable("w")
    reported: dict[JobTable, list[work.Report]] = {at_once: [], in_slices: []}
    for table in reported:
        table.follow(order_of_both, model, SETTINGS)
    for step in range(1, 5):
        reported[at_once] += at_once.on_scan(scan(step)) + searched(at_once)
        reported[in_slices] += in_slices.on_scan(scan(step)) + in_slices.search_on()
    reported[in_slices] += searched(in_slices)

    def of(kind: type, reports: list[work.Report]) -> list[bytes]:
        return [encode(report) for report in reports if isinstance(report, kind)]

    assert len(of(work.SearchReport, reported[at_once])) == 4
    for kind in (work.SearchReport, work.TrackReport):
        assert of(kind, reported[in_slices]) == of(kind, reported[at_once])


def test_a_search_that_is_far_behind_skips_no_scan_and_reports_places_of_each(
    model: SensorModel,
) -> None:
    """Its evidence would be that of fewer scans, and count for more than the other shards'."""
    table = table_with(model, search())
    for step in range(80):
        assert table.on_scan(scan(step)) == [], "clusters would not wait for it"
    reports = searched(table)
    assert [report.step for report in reports] == list(range(80))
    assert all(report.places for report in reports[:4])
    assert reports[3].places.share.array().sum() <= 1.0 + 1e-9


def test_a_search_weighs_each_scan_with_the_settings_of_its_step(model: SensorModel) -> None:
    fewer = replace(SETTINGS, sensor=replace(SETTINGS.sensor, max_beams=9))
    other = model_of(plain_room(), fewer.sensor)
    at_once, later = table_with(model, search()), table_with(model, search())
    reported = at_once.on_scan(scan(0)) + searched(at_once) + later.on_scan(scan(0))
    for table in (at_once, later):
        table.use(other, fewer)
        table.on_scan(scan(1))
    assert searched(later) == reported + searched(at_once)


def test_a_search_that_has_ended_is_not_continued(model: SensorModel) -> None:
    table = table_with(model, search())
    table.on_scan(scan(0))
    assert table.search_on() == []
    table.follow(order(track("c0", cloud())), model, SETTINGS)
    assert not table.searches
    assert table.search_on() == []


def test_several_scans_far_ahead_are_followed_and_so_is_the_return(model: SensorModel) -> None:
    table = table_with(model, track("c0", cloud()))
    reports_of(table, range(1, 4))
    forged = [replace(scan(3 + n), step=10**9 + n) for n in range(1, 4)]
    assert [report.step for one in forged for report in table.on_scan(one)] == [10**9 + 3]
    table.follow(order(track("c1", cloud(3), epoch=2)), model, SETTINGS)
    assert [report.step for report in reports_of(table, range(7, 11))] == [9, 10]


HERE = (0.0, 0.0, 0.0)


def test_reports_since_a_step_come_in_their_order() -> None:
    recent = RecentReports()
    for step in range(5):
        for job in ("c1", "c0"):
            recent.add(reports.tracked(job, step, 0.5, HERE))
    assert [(r.step, r.job_id) for r in recent.since(2)] == [
        (3, "c0"), (3, "c1"), (4, "c0"), (4, "c1"),
    ]  # fmt: skip


def test_only_the_last_report_keeps_its_particles() -> None:
    recent = RecentReports()
    for step in (10, 20):
        recent.add(reports.tracked("c0", step, 0.5, HERE, snapshot=reports.cloud_at(HERE, step)))
    old, new = recent.since(0)
    assert old.snapshot is None
    assert new.snapshot is not None


def test_fewer_reports_are_kept_of_searches_than_of_clusters() -> None:
    recent = RecentReports()
    for step in range(2 * KEPT_STEPS):
        recent.add(reports.tracked("c0", step, 0.5, HERE))
        recent.add(reports.searched("s0.0", step, {HERE: 1.0}))
    kept = recent.since(-1)
    assert sum(r.job_id == "c0" for r in kept) == KEPT_STEPS
    assert sum(r.job_id == "s0.0" for r in kept) == KEPT_SEARCH_STEPS
    assert recent.since(2 * KEPT_STEPS) == []
    again = recent.since(2 * KEPT_STEPS, searches=True)
    assert [r.job_id for r in again] == ["s0.0"] * KEPT_SEARCH_STEPS


def test_ended_jobs_are_forgotten() -> None:
    recent = RecentReports()
    for job in ("c0", "c1"):
        recent.add(reports.tracked(job, 1, 0.5, HERE))
    recent.keep_only(["c1", "c2"])
    assert [r.job_id for r in recent.since(0)] == ["c1"]


MS = 1_000_000


def paused_for(step: int, *, founded: bool = True) -> SearchPause:
    """The step before is decided, this one's scan comes at 10 ms."""
    pause = SearchPause()
    pause.on_checkpoint(step - 1, founded=founded)
    pause.on_scan(step, 10 * MS)
    return pause


def test_searches_wait_until_the_step_is_decided() -> None:
    pause = paused_for(7)
    assert pause.left_ns(12 * MS) == LONGEST_NS - 2 * MS
    pause.on_checkpoint(7, founded=True)
    assert pause.left_ns(12 * MS) == 0


def test_an_undecided_step_pauses_searches_for_a_limited_time() -> None:
    pause = paused_for(7)
    assert pause.left_ns(10 * MS + LONGEST_NS) == 0
    pause.on_scan(8, 500 * MS)
    pause.on_checkpoint(7, founded=True)
    assert pause.left_ns(500 * MS) == 0, "a belief that lags behind may wait for the search"
    pause.on_checkpoint(8, founded=True)
    pause.on_scan(9, 600 * MS)
    assert pause.left_ns(600 * MS) == LONGEST_NS


def test_the_first_search_is_not_paused() -> None:
    assert paused_for(0, founded=False).left_ns(12 * MS) == 0
    assert SearchPause().left_ns(0) == 0


def test_a_restart_of_steps_ends_the_pause() -> None:
    pause = paused_for(700)
    pause.on_scan(3, 20 * MS)
    assert pause.left_ns(20 * MS) == 0
