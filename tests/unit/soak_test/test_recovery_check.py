from soak_test.availability import Availability
from soak_test.recovery_check import WITHIN_S, Recovery
from soak_test.schedule import Kind
from soak_test.verdict import Verdict
from tests.unit.soak_test.hear import at, fault


def killed(check: Recovery, kind: Kind = Kind.WORKER_KILLED) -> None:
    """worker-1 tracks c7, worker-2 tracks c8; at 10 s the first is hit."""
    check.reported(at(9.9), "worker-1", "c7")
    check.reported(at(9.9), "worker-1", "s3.0")
    check.reported(at(9.9), "worker-2", "c8")
    check.fault(fault(kind, 10.0, target="worker-1"))


def verdict_of(check: Recovery, kind: Kind, now_s: float) -> Verdict:
    return dict(zip(list(KINDS), check.verdicts(at(now_s)), strict=True))[kind]


KINDS = tuple(WITHIN_S)


def test_a_cluster_that_another_worker_reports_on_has_recovered() -> None:
    check = Recovery(Availability())
    killed(check)
    check.reported(at(10.05), "worker-1", "c7")  # was on its way
    check.reported(at(10.4), "worker-3", "c7")
    verdict = verdict_of(check, Kind.WORKER_KILLED, 60.0)
    assert verdict.kept is True
    assert verdict.figures == {"recovered": 1, "longest_s": 0.4, "late": 0}


def test_a_cluster_that_nobody_reports_on_is_missed() -> None:
    check = Recovery(Availability())
    killed(check)
    assert verdict_of(check, Kind.WORKER_KILLED, 11.0).kept is None
    verdict = verdict_of(check, Kind.WORKER_KILLED, 60.0)
    assert verdict.kept is False
    assert "c7 of worker-1" in verdict.breaks[0].what


def test_a_cluster_that_leaves_the_belief_is_not_waited_for() -> None:
    check = Recovery(Availability())
    killed(check)
    check.believed([8, 9])
    assert verdict_of(check, Kind.WORKER_KILLED, 60.0).kept is None


def test_a_frozen_worker_that_wakes_up_goes_on_itself() -> None:
    check = Recovery(Availability())
    killed(check, Kind.WORKER_FROZEN)
    check.reported(at(11.0), "worker-1", "c7")
    assert verdict_of(check, Kind.WORKER_FROZEN, 60.0).kept is True


def test_when_all_are_killed_all_clusters_are_waited_for() -> None:
    check = Recovery(Availability())
    killed(check, Kind.ALL_WORKERS_KILLED)
    check.reported(at(14.0), "worker-1", "c7")
    assert verdict_of(check, Kind.ALL_WORKERS_KILLED, 60.0).figures["late"] == 1


def test_workers_that_track_are_those_that_reported_lately() -> None:
    check = Recovery(Availability())
    check.reported(at(1.0), "worker-1", "c7")
    check.reported(at(9.0), "worker-2", "c8")
    check.reported(at(9.0), "worker-3", "s3.0")
    assert check.trackers(at(9.5)) == ["worker-2"]


def test_all_workers_that_are_cut_off_are_hit() -> None:
    check = Recovery(Availability())
    check.reported(at(9.9), "worker-1", "c7")
    check.reported(at(9.9), "worker-2", "c8")
    check.reported(at(9.9), "worker-3", "c9")
    check.fault(fault(Kind.WORKER_LINKS_CUT, 10.0, 60.0, target="worker-1 worker-3"))
    check.reported(at(10.05), "worker-1", "c7")  # was on its way
    check.reported(at(12.4), "worker-2", "c7")
    verdict = verdict_of(check, Kind.WORKER_LINKS_CUT, 60.0)
    assert verdict.figures == {"recovered": 1, "longest_s": 2.4, "late": 1}
    assert "c9 of worker-3" in verdict.breaks[0].what
