import pytest

from protocol.errors import OldTermError
from protocol.work import Checkpoint, WorkOrder
from worker.allegiance import Allegiance


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
    allegiance = Allegiance()
    assert allegiance.check(order(5, 1))
    with pytest.raises(OldTermError, match="term 4, but term 5"):
        allegiance.check(order(4, 900))


def test_an_order_that_a_later_one_has_overtaken_is_left_out() -> None:
    allegiance = Allegiance()
    assert allegiance.check(order(5, 2))
    allegiance.order = 2
    assert not allegiance.check(order(5, 1))
    assert allegiance.check(order(6, 1)), "a new coordinator counts from the start"


def test_a_question_or_a_checkpoint_fences_lower_terms_too() -> None:
    asked, told = Allegiance(), Allegiance()
    asked.hear(7)
    told.keep(checkpoint(7, 0), b"seven")
    for allegiance in (asked, told):
        with pytest.raises(OldTermError, match="term 7 rules"):
            allegiance.check(order(6, 1))


def test_the_newest_checkpoint_is_kept() -> None:
    allegiance = Allegiance()
    for term, serial in ((5, 1), (5, 3), (5, 2), (4, 9)):
        allegiance.keep(checkpoint(term, serial), f"{term}.{serial}".encode())
    assert (allegiance.checkpoint, allegiance.step) == (b"5.3", 3)


def test_a_belief_that_has_clusters_is_not_forgotten_for_one_that_has_none() -> None:
    allegiance = Allegiance()
    allegiance.keep(checkpoint(5, 1), b"founded")
    allegiance.keep(checkpoint(6, 1, founded=False), b"cold")
    assert allegiance.checkpoint == b"founded"
    assert allegiance.term == 6
