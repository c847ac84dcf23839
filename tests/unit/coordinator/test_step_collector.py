import pytest

from clustermcl.coordinator.jobs import HAND_OVER_NS
from clustermcl.coordinator.step_collector import (
    BULKY_REPORTS,
    FETCH_NS,
    KEPT_AHEAD,
    REPORTS_AHEAD,
    UNANSWERED_NS,
    ReadyStep,
    StepCollector,
)  # fmt: skip
from clustermcl.protocol.work import Report
from clustermcl.runtime.settings import CoordinatorSettings
from tests.unit.coordinator.reports import cloud_at, elsewhere, scan, searched, tracked

HERE = (0.0, 0.0, 0.0)
DEADLINE_NS = 500_000_000


def collector(*steps: int, lockstep: bool = False) -> StepCollector:
    """With the scans of these steps, which arrived at 0."""
    made = StepCollector(CoordinatorSettings(step_deadline_s=0.5, lockstep_deadline_s=20.0))
    for step in steps:
        made.on_scan(scan(step, lockstep=lockstep), 0)
    return made


def ready(
    made: StepCollector, *jobs: str, at_ns: int = 0, may_lag: str = "", placed_ns: int = 0
) -> ReadyStep | None:
    return made.ready(jobs, lambda _: placed_ns, at_ns, [may_lag])


def given_out(made: StepCollector, *jobs: str, at_ns: int = 0, may_lag: str = "") -> ReadyStep:
    given = ready(made, *jobs, at_ns=at_ns, may_lag=may_lag)
    assert given is not None
    return given


def report(job: str, step: int = 0, share: float = 1.0) -> Report:
    return searched(job, step, {HERE: share}) if job[0] == "s" else tracked(job, step, share, HERE)


def test_a_step_is_ready_once_all_expected_reports_are_in() -> None:
    made = collector(0)
    made.on_report(tracked("c0", 0, 1.0, HERE, snapshot=cloud_at(HERE, 0)), 0)
    assert ready(made, "c0", "c1", at_ns=1) is None
    made.on_report(report("c1"), 0)
    given = given_out(made, "c0", "c1", at_ns=1)
    assert given.reports == (report("c0"), report("c1")), "without particles"


@pytest.mark.parametrize(("age_ns", "counts"), [(UNANSWERED_NS, True), (UNANSWERED_NS + 1, False)])
def test_a_report_that_came_long_before_its_scan_does_not_count(age_ns: int, counts: bool) -> None:
    """Forged ones on steps to come made each step complete before the true report came."""
    made, true = collector(), report("c0", 7)
    made.on_report(report("c0", 7, 9.0), 0)
    made.on_scan(scan(7), age_ns)
    assert (ready(made, "c0", at_ns=age_ns) is not None) == counts
    if not counts:
        made.on_report(true, age_ns)
        assert given_out(made, "c0", at_ns=age_ns).reports == (true,)


def test_reports_that_workers_repeat_after_an_outage_wait_for_their_scans() -> None:
    made, repeated, now_ns = collector(), report("c0", 7), 60 * UNANSWERED_NS
    made.restart_deadlines(now_ns)
    made.on_report(repeated, now_ns + 1)
    now_ns += 3 * UNANSWERED_NS
    made.on_scan(scan(7), now_ns)
    assert given_out(made, "c0", at_ns=now_ns).reports == (repeated,)


@pytest.mark.parametrize(
    ("lockstep", "deadline_ns"), [(False, DEADLINE_NS), (True, 40 * DEADLINE_NS)]
)
def test_a_step_is_ready_without_missing_reports_after_its_deadline(
    lockstep: bool, deadline_ns: int
) -> None:
    made = collector(0, lockstep=lockstep)
    assert ready(made, "c0", at_ns=deadline_ns - 1) is None
    assert given_out(made, "c0", at_ns=deadline_ns).reports == ()


def test_a_step_waits_longer_for_a_job_that_just_changed_hands() -> None:
    made, placed = collector(0), DEADLINE_NS - 1
    assert ready(made, "c0", placed_ns=placed, at_ns=placed + HAND_OVER_NS - 1) is None
    assert ready(made, "c0", placed_ns=placed, at_ns=placed + HAND_OVER_NS) is not None


def test_steps_are_given_out_in_order_and_once() -> None:
    made = collector(1, 0, 1)
    assert [given_out(made).scan.step for _ in range(2)] == [0, 1]
    assert not made.on_scan(scan(1), 0), "an applied step is never applied again"
    assert ready(made) is None


def test_lost_scans_are_reported_waited_for_and_counted_if_they_never_arrive() -> None:
    made = collector(0, 3, 5, 7)
    given_out(made)
    assert collector().lost_before(scan(7)) is made.lost_before(scan(1)) is None
    assert made.lost_before(scan(3)) == (1, 2)
    assert ready(made, at_ns=FETCH_NS - 1) is None
    for step in (1, 2):
        made.on_scan(scan(step), 0)
    assert [given_out(made, at_ns=1).scan.step for _ in range(3)] == [1, 2, 3]
    assert made.steps_lost == 0
    made.is_fetching = True
    assert ready(made, at_ns=UNANSWERED_NS - 1) is None
    made.is_fetching = False
    assert given_out(made, at_ns=FETCH_NS).scan.step == 5, "answered, without the scan"
    made.is_fetching = True
    assert given_out(made, at_ns=UNANSWERED_NS).scan.step == 7, "the bridge is silent"
    assert made.steps_lost == 2


def test_a_late_track_report_is_useless_but_a_late_search_report_is_used() -> None:
    made = collector(0, 1)
    given_out(made)
    assert not made.on_report(report("c0"), 0)
    assert made.on_report(report("s0.0"), 0)
    assert [one.job_id for one in given_out(made).reports] == ["s0.0"]


def test_a_search_next_to_clusters_delays_no_step() -> None:
    made, late = collector(0, 1), report("s1.0")
    assert ready(made, "c0", "s1.0", may_lag="s1.0", at_ns=1) is None
    made.on_report(report("c0"), 0)
    assert ready(made, "c0", "s1.0", at_ns=1) is None
    given_out(made, "c0", "s1.0", may_lag="s1.0", at_ns=1)
    assert made.on_report(late, 0)
    made.on_report(report("c0", 1), 0)
    assert late in given_out(made, "c0", "s1.0", may_lag="s1.0", at_ns=3).reports


def test_a_step_waits_for_a_search_in_lockstep_or_if_so_configured() -> None:
    assert ready(collector(0, lockstep=True), "s1.0", may_lag="s1.0", at_ns=19 * 10**9) is None
    patient = StepCollector(CoordinatorSettings(search_deadline_s=0.2))
    patient.on_scan(scan(0), 0)
    assert ready(patient, "s1.0", may_lag="s1.0", at_ns=199_999_999) is None
    assert ready(patient, "s1.0", may_lag="s1.0", at_ns=200_000_000) is not None


def test_a_successor_keeps_waiting_scans_and_no_reports() -> None:
    """They belong to its old jobs, which have the same ids."""
    made, other = collector(3, 4), collector(3)
    for step in (3, 4):
        made.on_report(elsewhere(step, -1.0), 0)
    made.on_report(report("s0.0", 5), 0)
    given_out(other, at_ns=1)
    made.resume(other)
    assert ready(made, "e0", at_ns=1) is None, "it waits for the other's job"
    given = given_out(made, at_ns=1)
    assert (given.scan.step, given.reports) == (4, ())
    made.on_scan(scan(5), 2)
    assert given_out(made, at_ns=3).reports == ()


def test_steps_before_the_start_of_the_search_are_discarded() -> None:
    made = collector(3, 4, 6)
    made.begin_after(5)
    assert not made.on_scan(scan(5), 0)
    assert given_out(made, at_ns=1).scan.step == 6
    made.begin_after(20)
    made.on_scan(scan(7), 2)
    assert ready(made, at_ns=3) is not None, "it has begun, and goes on from there"


def test_a_report_of_a_step_far_above_all_scans_is_refused() -> None:
    made, far = collector(7), report("c0", 8 + REPORTS_AHEAD)
    assert made.has_room_for(report("c0", 7 + REPORTS_AHEAD))
    assert not made.has_room_for(far)
    given_out(made)
    assert not made.has_room_for(far)
    assert made.has_room_for(report("c0", 3)), "it is over, and kept nowhere"


def test_before_the_first_scan_reports_are_kept_for_a_bounded_number_of_steps() -> None:
    made = collector()
    for one in (report("c0", step) for step in range(2 * KEPT_AHEAD)):
        if made.has_room_for(one):
            made.on_report(one, 0)
    assert not made.has_room_for(report("c0", KEPT_AHEAD + 1))
    assert made.has_room_for(report("c1", KEPT_AHEAD))


def test_a_bounded_number_of_reports_of_a_search_is_kept() -> None:
    made = collector(0)
    for one in (report("s0.0", step) for step in range(BULKY_REPORTS)):
        assert made.has_room_for(one)
        made.on_report(one, 0)
    assert not made.has_room_for(report("s0.0", BULKY_REPORTS))
    assert made.has_room_for(report("s0.0", 3, 0.5)), "it takes the other's place"
    assert made.has_room_for(report("s0.1", BULKY_REPORTS))
    assert made.has_room_for(report("c0", BULKY_REPORTS))


def test_the_newest_late_reports_of_a_search_are_kept() -> None:
    made = collector(*range(2 * BULKY_REPORTS + 1))
    for _ in range(2 * BULKY_REPORTS):
        given_out(made)
    for step in range(2 * BULKY_REPORTS):
        assert made.on_report(report("s0.0", step), 0)
    made.on_report(report("s0.1"), 0)
    reports = given_out(made).reports
    kept = [one.step for one in reports if one.job_id == "s0.0"]
    assert kept == list(range(BULKY_REPORTS, 2 * BULKY_REPORTS))
    assert len(reports) == BULKY_REPORTS + 1
