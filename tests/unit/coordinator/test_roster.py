"""Who is there, as far as a coordinator can know it whose own link may break."""

from coordinator.roster import GRACE_NS, SETTLE_NS, Change, Roster

MS, SECOND = 1_000_000, 1_000_000_000


def roster_of(*workers: str) -> Roster:
    roster = Roster()
    for worker in workers:
        assert roster.token(worker, True, 0) == [Change(worker, "joined")]
    return roster


def test_a_worker_that_dies_has_left_a_moment_later() -> None:
    roster = roster_of("a", "b")
    assert roster.token("a", False, SECOND) == []
    assert roster.due(SECOND + SETTLE_NS - 1) == []
    assert roster.due(SECOND + SETTLE_NS) == [Change("a", "left")]
    assert roster.due(2 * SECOND) == []


def test_a_worker_that_is_back_within_that_moment_was_started_anew() -> None:
    roster = roster_of("a")
    roster.token("a", False, SECOND)
    changes = roster.token("a", True, SECOND + 10 * MS)
    assert changes == [Change("a", "left"), Change("a", "joined")]
    assert roster.due(9 * SECOND) == []


def test_nobody_leaves_with_our_own_link() -> None:
    roster = roster_of("a", "b")
    roster.token("a", False, SECOND)  # tokens vanish before the link does
    roster.token("b", False, SECOND)
    roster.link(False, SECOND + MS)
    assert not roster.linked
    assert roster.due(60 * SECOND) == []
    roster.link(True, 60 * SECOND)
    assert roster.token("a", True, 60 * SECOND + MS) == [Change("a", "returned")]
    assert roster.token("b", True, 60 * SECOND + MS) == [Change("b", "returned")]
    assert roster.due(99 * SECOND) == []


def test_who_does_not_come_back_with_our_link_has_left_after_the_grace() -> None:
    roster = roster_of("a", "b")
    roster.token("a", False, SECOND)
    roster.token("b", False, SECOND)
    roster.link(False, SECOND)
    roster.link(True, 2 * SECOND)
    roster.token("a", True, 2 * SECOND + MS)
    assert roster.due(2 * SECOND + GRACE_NS - 1) == []
    assert roster.due(2 * SECOND + GRACE_NS) == [Change("b", "left")]


def test_who_appears_for_the_first_time_after_a_lost_link_joins() -> None:
    roster = roster_of("a")
    roster.link(False, SECOND)
    roster.link(True, 2 * SECOND)
    assert roster.token("c", True, 2 * SECOND) == [Change("c", "joined")]


def test_a_link_that_breaks_again_in_the_grace_freezes_again() -> None:
    roster = roster_of("a")
    roster.token("a", False, SECOND)
    roster.link(False, SECOND)
    roster.link(True, 2 * SECOND)
    roster.link(False, 3 * SECOND)
    assert roster.due(60 * SECOND) == []
    roster.link(True, 61 * SECOND)
    assert roster.due(61 * SECOND + GRACE_NS) == [Change("a", "left")]


def test_the_first_link_needs_no_grace() -> None:
    roster = Roster()
    roster.link(True, 0)
    roster.token("a", True, 0)
    roster.token("a", False, 1)
    assert roster.due(1 + SETTLE_NS) == [Change("a", "left")]


def test_a_token_of_somebody_unknown_that_vanishes_is_nothing() -> None:
    roster = Roster()
    assert roster.token("a", False, 0) == []
    assert roster.due(SECOND) == []
