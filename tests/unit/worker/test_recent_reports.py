from clustermcl.protocol.steps import KEPT_STEPS
from clustermcl.worker.job_table import KEPT_SEARCH_STEPS, RecentReports
from tests.unit.coordinator.reports import cloud_at, searched, tracked

HERE = (0.0, 0.0, 0.0)


def test_reports_since_a_step_come_in_their_order() -> None:
    recent = RecentReports()
    for step in range(5):
        for job in ("c1", "c0"):
            recent.add(tracked(job, step, 0.5, HERE))
    assert [(r.step, r.job_id) for r in recent.since(2)] == [
        (3, "c0"), (3, "c1"), (4, "c0"), (4, "c1"),
    ]  # fmt: skip


def test_only_the_last_report_keeps_its_particles() -> None:
    recent = RecentReports()
    for step in (10, 20):
        recent.add(tracked("c0", step, 0.5, HERE, snapshot=cloud_at(HERE, step)))
    old, new = recent.since(0)
    assert old.snapshot is None
    assert new.snapshot is not None


def test_fewer_reports_are_kept_of_searches_than_of_clusters() -> None:
    recent = RecentReports()
    for step in range(2 * KEPT_STEPS):
        recent.add(tracked("c0", step, 0.5, HERE))
        recent.add(searched("s0.0", step, {HERE: 1.0}))
    kept = recent.since(-1)
    assert sum(r.job_id == "c0" for r in kept) == KEPT_STEPS
    assert sum(r.job_id == "s0.0" for r in kept) == KEPT_SEARCH_STEPS
    assert recent.since(2 * KEPT_STEPS) == []
    again = recent.since(2 * KEPT_STEPS, searches=True)
    assert [r.job_id for r in again] == ["s0.0"] * KEPT_SEARCH_STEPS


def test_ended_jobs_are_forgotten() -> None:
    recent = RecentReports()
    for job in ("c0", "c1"):
        recent.add(tracked(job, 1, 0.5, HERE))
    recent.keep_only(["c1", "c2"])
    assert [r.job_id for r in recent.since(0)] == ["c1"]
