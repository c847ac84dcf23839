from clustermcl.coordinator.recovery import APART_US, UNSEEN_NS, Term
from clustermcl.protocol.work import MAX_RELAYED_AHEAD_US, OrderAnswer, TakeOver, check_term

KNOWN = 8
"""Term of another coordinator."""


def test_a_term_is_raised_above_all_received_terms_before_it_begins() -> None:
    term = Term(5)
    assert term.on_term(KNOWN)
    raised = term.number
    assert raised > KNOWN
    assert not term.on_term(raised), "that is its own"
    assert term.on_term(raised + 20)
    assert term.number > raised + 20
    assert term.outranked_by is None


def test_a_raised_term_lies_above_the_epochs_of_the_other_term() -> None:
    term = Term(KNOWN + 3)
    assert term.on_term(KNOWN), "it began a moment before, and may have given jobs since"
    assert term.number >= KNOWN + APART_US


def test_a_term_that_has_begun_is_outranked_by_the_highest_received_term() -> None:
    term = Term(5)
    term.begun = True
    assert not term.on_term(5)
    assert term.outranked_by is None
    assert not term.on_term(7), "it stays as it is"
    term.on_term(6)
    assert (term.number, term.outranked_by) == (5, 7)


def test_a_workers_term_deposes_no_coordinator_but_raises_the_term_later() -> None:
    term = Term(5)
    term.begun = True
    term.on_worker_term(9, now_ns=0)
    term.on_worker_term(8, now_ns=1)
    assert not term.rises_above_workers(UNSEEN_NS - 1)
    assert (term.number, term.outranked_by) == (5, None)
    assert term.rises_above_workers(UNSEEN_NS)
    assert term.number > 9
    assert not term.rises_above_workers(2 * UNSEEN_NS)


def test_a_claimed_term_leaves_room_for_higher_terms() -> None:
    term = Term(1_000)
    claimed = OrderAnswer(sender="w", order=1, jobs=(), term=MAX_RELAYED_AHEAD_US)
    for _ in range(100):
        check_term(claimed, clock_ns=0)
        term.on_term(claimed.term)
        assert not term.on_term(term.number)
    check_term(TakeOver(sender="c", term=term.number), clock_ns=0)
