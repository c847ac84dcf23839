import pytest

from protocol.errors import OldTermError
from protocol.work import Checkpoint, WorkOrder
from worker.term_fence import TermFence


def order(term: int, number: int) -> WorkOrder:
    return WorkOrder(
        sender="coordinator", term=term, order=number, map_digest="map", filter_settings={},
        snapshot_every_steps=10, keep=(), begin=(),
    )  # fmt: skip


def checkpoint(term: int, serial: int, *, founded: bool = True) -> Checkpoint:
    return Checkpoint(
        sender="coordinator", term=term, serial=serial, step=serial, founded=founded, state=b""
    )


def test_orders_of_a_lower_term_are_refused_with_both_terms() -> None:
    term_fence = TermFence()
    assert term_fence.check(order(5, 1))
    with pytest.raises(OldTermError, match="term 4, but term 5"):
        term_fence.check(order(4, 900))


def test_an_order_that_a_later_one_has_overtaken_is_left_out() -> None:
    term_fence = TermFence()
    assert term_fence.check(order(5, 2))
    term_fence.order = 2
    assert not term_fence.check(order(5, 1))
    assert term_fence.check(order(6, 1)), "a new coordinator counts from the start"


def test_a_question_or_a_checkpoint_fences_lower_terms_too() -> None:
    asked, told = TermFence(), TermFence()
    asked.hear(7)
    told.keep(checkpoint(7, 0), b"seven")
    for term_fence in (asked, told):
        with pytest.raises(OldTermError, match="term 7 rules"):
            term_fence.check(order(6, 1))


def test_the_newest_checkpoint_is_kept() -> None:
    term_fence = TermFence()
    for term, serial in ((5, 1), (5, 3), (5, 2), (4, 9)):
        term_fence.keep(checkpoint(term, serial), f"{term}.{serial}".encode())
    assert (term_fence.checkpoint, term_fence.step) == (b"5.3", 3)


def test_a_belief_that_has_clusters_is_not_forgotten_for_one_that_has_none() -> None:
    term_fence = TermFence()
    term_fence.keep(checkpoint(5, 1), b"founded")
    term_fence.keep(checkpoint(6, 1, founded=False), b"cold")
    assert term_fence.checkpoint == b"founded"
    assert term_fence.term == 6
