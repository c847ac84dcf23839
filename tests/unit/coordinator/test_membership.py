from clustermcl.coordinator.events import WorkerJoined, WorkerLeft, WorkerReturned
from clustermcl.coordinator.replica import GRACE_NS, SETTLE_NS, Membership

MS, SECOND = 1_000_000, 1_000_000_000


def membership_of(*workers: str) -> Membership:
    membership = Membership()
    for worker in workers:
        assert membership.token(worker, True, 0) == [WorkerJoined(worker)]
    return membership


def test_a_worker_whose_token_vanishes_leaves_after_the_settling_time() -> None:
    membership = membership_of("a", "b")
    assert membership.token("a", False, SECOND) == []
    assert membership.left(SECOND + SETTLE_NS - 1) == []
    assert membership.left(SECOND + SETTLE_NS) == [WorkerLeft("a")]
    assert membership.left(2 * SECOND) == []


def test_a_token_that_reappears_within_the_settling_time_shows_a_restart() -> None:
    membership = membership_of("a")
    membership.token("a", False, SECOND)
    changes = membership.token("a", True, SECOND + 10 * MS)
    assert changes == [WorkerLeft("a"), WorkerJoined("a")]
    assert membership.left(9 * SECOND) == []


def test_no_worker_leaves_while_the_own_link_is_lost() -> None:
    membership = membership_of("a", "b")
    membership.token("a", False, SECOND)  # tokens vanish before the link does
    membership.token("b", False, SECOND)
    membership.link(False, SECOND + MS)
    assert not membership.linked
    assert membership.left(60 * SECOND) == []
    membership.link(True, 60 * SECOND)
    assert membership.token("a", True, 60 * SECOND + MS) == [WorkerReturned("a")]
    assert membership.token("b", True, 60 * SECOND + MS) == [WorkerReturned("b")]
    assert membership.left(99 * SECOND) == []


def test_a_worker_that_stays_away_after_the_own_link_is_back_leaves_after_the_grace_period() -> (
    None
):
    membership = membership_of("a", "b")
    membership.token("a", False, SECOND)
    membership.token("b", False, SECOND)
    membership.link(False, SECOND)
    membership.link(True, 2 * SECOND)
    membership.token("a", True, 2 * SECOND + MS)
    assert membership.left(2 * SECOND + GRACE_NS - 1) == []
    assert membership.left(2 * SECOND + GRACE_NS) == [WorkerLeft("b")]


def test_a_link_that_is_lost_again_in_the_grace_period_restarts_it() -> None:
    membership = membership_of("a")
    membership.token("a", False, SECOND)
    membership.link(False, SECOND)
    membership.link(True, 2 * SECOND)
    membership.link(False, 3 * SECOND)
    assert membership.left(60 * SECOND) == []
    membership.link(True, 61 * SECOND)
    assert membership.left(61 * SECOND + GRACE_NS) == [WorkerLeft("a")]
