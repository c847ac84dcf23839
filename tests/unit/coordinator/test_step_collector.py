from collections.abc import Sequence

import pytest

from clustermcl.coordinator import step_collector
from clustermcl.coordinator.jobs import HAND_OVER_NS
from clustermcl.runtime.settings import CoordinatorSettings
from tests.unit.coordinator.reports import cloud_at, elsewhere, scan, searched, tracked

HERE = (0.0, 0.0, 0.0)
DEADLINE_NS = 500_000_000


def collector() -> step_collector.StepCollector:
    return step_collector.StepCollector(
        CoordinatorSettings(step_deadline_s=0.5, lockstep_deadline_s=20.0)
    )


def never_placed(_job_id: str) -> int:
    return 0


def given_out(
    made: step_collector.StepCollector, *jobs: str, now_ns: int = 0, deferrable: Sequence[str] = ()
) -> step_collector.ReadyStep:
    ready = made.ready(jobs, never_placed, now_ns, deferrable)
    assert ready is not None
    return ready


def test_a_step_is_ready_once_all_expected_reports_are_in() -> None:
    made = collector()
    made.on_scan(scan(0), 0)
    made.on_report(tracked("c0", 0, 1.0, HERE), 0)
    assert made.ready(["c0", "c1"], never_placed, 1) is None
    made.on_report(tracked("c1", 0, 1.0, HERE), 0)
    ready = given_out(made, "c0", "c1", now_ns=1)
    assert {report.job_id for report in ready.reports} == {"c0", "c1"}


@pytest.mark.parametrize(
    ("age_ns", "counts"),
    [(step_collector.UNANSWERED_NS, True), (step_collector.UNANSWERED_NS + 1, False)],
)
def test_a_report_that_came_long_before_its_scan_does_not_count(age_ns: int, counts: bool) -> None:
    """Forged ones on steps to come made each step complete before the true report came."""
    made, forged, true = collector(), tracked("c0", 7, 9.0, HERE), tracked("c0", 7, 1.0, HERE)
    made.on_report(forged, 0)
    made.on_scan(scan(7), age_ns)
    assert (made.ready(["c0"], never_placed, age_ns) is not None) == counts
    if not counts:
        made.on_report(true, age_ns)
        assert given_out(made, "c0", now_ns=age_ns).reports == (true,)


def test_reports_that_workers_repeat_after_an_outage_wait_for_their_scans() -> None:
    made, repeated, now_ns = (
        collector(),
        tracked("c0", 7, 1.0, HERE),
        60 * step_collector.UNANSWERED_NS,
    )
    made.restart_deadlines(now_ns)
    made.on_report(repeated, now_ns + 1)
    now_ns += 3 * step_collector.UNANSWERED_NS
    made.on_scan(scan(7), now_ns)
    assert given_out(made, "c0", now_ns=now_ns).reports == (repeated,)


def test_a_step_is_ready_without_missing_reports_after_its_deadline() -> None:
    made = collector()
    made.on_scan(scan(0), 0)
    assert made.ready(["c0"], never_placed, DEADLINE_NS - 1) is None
    assert given_out(made, "c0", now_ns=DEADLINE_NS).reports == ()


def test_a_lockstep_step_waits_long() -> None:
    made = collector()
    made.on_scan(scan(0, lockstep=True), 0)
    assert made.ready(["c0"], never_placed, 19_000_000_000) is None


def test_a_step_waits_longer_for_a_job_that_just_changed_hands() -> None:
    made = collector()
    made.on_scan(scan(0), 0)
    placed = DEADLINE_NS - 1

    def placed_ns(_job_id: str) -> int:
        return placed

    assert made.ready(["c0"], placed_ns, placed + HAND_OVER_NS - 1) is None
    assert made.ready(["c0"], placed_ns, placed + HAND_OVER_NS) is not None


def test_steps_are_given_out_in_order_and_once() -> None:
    made = collector()
    for step in (1, 0, 1):
        made.on_scan(scan(step), 0)
    steps = []
    while (ready := made.ready([], never_placed, 0)) is not None:
        steps.append(ready.scan.step)
    assert steps == [0, 1]
    assert not made.on_scan(scan(1), 0), "an applied step is never applied again"
    assert made.ready([], never_placed, 0) is None


def test_a_scan_that_never_arrives_is_counted_as_lost() -> None:
    made = collector()
    for step in (0, 3):
        made.on_scan(scan(step), 0)
        made.ready([], never_placed, step_collector.FETCH_NS)
    assert made.steps_lost == 2


def test_a_lost_scan_is_reported_and_waited_for_briefly() -> None:
    made = collector()
    made.on_scan(scan(0), 0)
    made.ready([], never_placed, 0)
    made.on_scan(scan(3), 0)
    assert made.lost_before(scan(3)) == (1, 2)
    assert made.ready([], never_placed, step_collector.FETCH_NS - 1) is None
    made.on_scan(scan(1), 0)
    made.on_scan(scan(2), 0)
    applied = [made.ready([], never_placed, 1) for _ in range(3)]
    assert [ready.scan.step for ready in applied if ready] == [1, 2, 3]
    assert made.steps_lost == 0


def test_a_lost_scan_is_waited_for_longer_while_the_bridge_has_not_answered() -> None:
    made = collector()
    made.on_scan(scan(0), 0)
    made.ready([], never_placed, 0)
    made.on_scan(scan(2), 0)
    made.is_fetching = True
    assert made.ready([], never_placed, step_collector.UNANSWERED_NS - 1) is None
    made.is_fetching = False
    assert made.ready([], never_placed, step_collector.FETCH_NS) is not None, (
        "answered, without the scan"
    )
    made.on_scan(scan(4), 0)
    made.is_fetching = True
    assert made.ready([], never_placed, step_collector.UNANSWERED_NS) is not None, (
        "the bridge is silent"
    )


def test_no_scan_is_lost_before_the_first_scan_or_between_consecutive_ones() -> None:
    made = collector()
    assert made.lost_before(scan(7)) is None
    made.on_scan(scan(7), 0)
    assert made.lost_before(scan(8)) is None


def test_a_late_track_report_is_useless_but_a_late_search_report_is_used() -> None:
    made = collector()
    made.on_scan(scan(0), 0)
    made.ready([], never_placed, 0)
    assert not made.on_report(tracked("c0", 0, 1.0, HERE), 0)
    assert made.on_report(searched("s0.0", 0, {HERE: 1.0}), 0)
    made.on_scan(scan(1), 0)
    assert [report.job_id for report in given_out(made).reports] == ["s0.0"]


def test_a_search_next_to_clusters_delays_no_step() -> None:
    made = collector()
    made.on_scan(scan(0), 0)
    jobs = ["c0", "s1.0"]
    assert made.ready(jobs, never_placed, 1, ["s1.0"]) is None
    made.on_report(tracked("c0", 0, 1.0, HERE), 0)
    assert made.ready(jobs, never_placed, 1) is None
    given_out(made, *jobs, now_ns=1, deferrable=["s1.0"])
    late = searched("s1.0", 0, {HERE: 1.0})
    assert made.on_report(late, 0)
    made.on_scan(scan(1), 2)
    made.on_report(tracked("c0", 1, 1.0, HERE), 0)
    assert late in given_out(made, *jobs, now_ns=3, deferrable=["s1.0"]).reports


def test_a_step_waits_for_a_search_in_lockstep_or_if_so_configured() -> None:
    made = collector()
    made.on_scan(scan(0, lockstep=True), 0)
    assert made.ready(["s1.0"], never_placed, 19_000_000_000, ["s1.0"]) is None
    patient = step_collector.StepCollector(CoordinatorSettings(search_deadline_s=0.2))
    patient.on_scan(scan(0), 0)
    assert patient.ready(["s1.0"], never_placed, 199_999_999, ["s1.0"]) is None
    assert patient.ready(["s1.0"], never_placed, 200_000_000, ["s1.0"]) is not None


def test_a_successor_keeps_waiting_scans_and_no_reports() -> None:
    """They belong to its old jobs, which have the same ids."""
    made, other = collector(), collector()
    for step in (3, 4):
        made.on_scan(scan(step), 0)
        made.on_report(elsewhere(step, -1.0), 0)
    made.on_report(searched("s0.0", 5, {HERE: 1.0}), 0)
    other.on_scan(scan(3), 0)
    other.ready([], never_placed, 1)
    made.resume(other)
    assert made.ready(["e0"], never_placed, 1) is None, "it waits for the other's job"
    ready = given_out(made, now_ns=1)
    assert (ready.scan.step, ready.reports) == (4, ())
    made.on_scan(scan(5), 2)
    assert given_out(made, now_ns=3).reports == ()


def test_steps_before_the_start_of_the_search_are_discarded() -> None:
    made = collector()
    for step in (3, 4, 6):
        made.on_scan(scan(step), 0)
    made.begin_after(5)
    assert not made.on_scan(scan(5), 0)
    assert given_out(made, now_ns=1).scan.step == 6
    made.begin_after(20)
    made.on_scan(scan(7), 2)
    assert made.ready([], never_placed, 3) is not None, "it has begun, and goes on from there"


def test_a_report_of_a_step_far_above_all_scans_is_refused() -> None:
    made = collector()
    made.on_scan(scan(7), 0)
    assert made.has_room_for(tracked("c0", 7 + step_collector.REPORTS_AHEAD, 1.0, HERE))
    far = tracked("c0", 8 + step_collector.REPORTS_AHEAD, 1.0, HERE)
    assert not made.has_room_for(far)
    made.ready([], never_placed, 0)
    assert not made.has_room_for(far)
    assert made.has_room_for(tracked("c0", 3, 1.0, HERE)), "it is over, and kept nowhere"


def test_before_the_first_scan_reports_are_kept_for_a_bounded_number_of_steps() -> None:
    made = collector()
    for step in range(2 * step_collector.KEPT_AHEAD):
        report = tracked("c0", step, 1.0, HERE)
        if made.has_room_for(report):
            made.on_report(report, 0)
    assert not made.has_room_for(tracked("c0", step_collector.KEPT_AHEAD + 1, 1.0, HERE))
    assert made.has_room_for(tracked("c1", step_collector.KEPT_AHEAD, 1.0, HERE))


def test_waiting_reports_have_no_particles() -> None:
    made = collector()
    made.on_scan(scan(0), 0)
    made.on_report(tracked("c0", 0, 1.0, HERE, snapshot=cloud_at(HERE, 0)), 0)
    assert given_out(made, "c0").reports == (tracked("c0", 0, 1.0, HERE),)


def test_a_bounded_number_of_reports_of_a_search_is_kept() -> None:
    made = collector()
    made.on_scan(scan(0), 0)
    for step in range(step_collector.BULKY_REPORTS):
        assert made.has_room_for(searched("s0.0", step, {HERE: 1.0}))
        made.on_report(searched("s0.0", step, {HERE: 1.0}), 0)
    assert not made.has_room_for(searched("s0.0", step_collector.BULKY_REPORTS, {HERE: 1.0}))
    assert made.has_room_for(searched("s0.0", 3, {HERE: 0.5})), "it takes the other's place"
    assert made.has_room_for(searched("s0.1", step_collector.BULKY_REPORTS, {HERE: 1.0}))
    assert made.has_room_for(tracked("c0", step_collector.BULKY_REPORTS, 1.0, HERE))


def test_the_newest_late_reports_of_a_search_are_kept() -> None:
    made = collector()
    for step in range(2 * step_collector.BULKY_REPORTS):
        made.on_scan(scan(step), 0)
        made.ready([], never_placed, 0)
    for step in range(2 * step_collector.BULKY_REPORTS):
        assert made.on_report(searched("s0.0", step, {HERE: 1.0}), 0)
    made.on_report(searched("s0.1", 0, {HERE: 1.0}), 0)
    made.on_scan(scan(2 * step_collector.BULKY_REPORTS), 0)
    ready = given_out(made)
    kept = [report.step for report in ready.reports if report.job_id == "s0.0"]
    assert kept == list(range(step_collector.BULKY_REPORTS, 2 * step_collector.BULKY_REPORTS))
    assert len(ready.reports) == step_collector.BULKY_REPORTS + 1
