import msgspec
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
    assert (term_fence.checkpoint, term_fence.earlier) == (b"5.3", (b"5.2",))
    assert term_fence.step == 2, "the reports since then make up for it"


def test_a_belief_that_has_clusters_is_not_forgotten_for_one_that_has_none() -> None:
    term_fence = TermFence()
    term_fence.keep(checkpoint(5, 1), b"founded")
    term_fence.keep(checkpoint(6, 1, founded=False), b"cold")
    assert term_fence.checkpoint == b"founded"
    assert term_fence.term == 6


def acting(term: int) -> TermFence:
    """Of a worker that a coordinator has given an order."""
    term_fence = TermFence()
    assert term_fence.check(order(term, 1))
    return term_fence


def kept(term_fence: TermFence, *told: tuple[int, int]) -> list[str]:
    """What is handed on after these terms and serials were heard, newest first."""
    for term, serial in told:
        term_fence.keep(checkpoint(term, serial), f"{term}.{serial}".encode())
    return [payload.decode() for payload in (term_fence.checkpoint, *term_fence.earlier)]


def test_the_last_two_are_kept_that_a_coordinator_has_gone_on_from() -> None:
    assert kept(acting(5), (5, 1), (5, 2), (5, 3), (5, 4)) == ["5.4", "5.3", "5.2"]


def test_a_sign_of_life_confirms_the_checkpoint_that_it_repeats() -> None:
    term_fence = acting(5)
    assert kept(term_fence, (5, 1), (5, 1)) == ["5.1"]
    assert kept(term_fence, (900, 0), (901, 0), (902, 0)) == ["902.0", "5.1"]


def test_a_strangers_checkpoint_of_the_acting_term_takes_the_place_of_none_that_is_good() -> None:
    term_fence = acting(5)
    assert kept(term_fence, (5, 1), (5, 2), (5, 2**50)) == [f"5.{2**50}", "5.2", "5.1"]
    assert kept(term_fence, (5, 3), (5, 4), (5, 5)) == [f"5.{2**50}", "5.5", "5.4", "5.3"]
    assert term_fence.step == 3, "reports since are told as well"


def test_however_much_who_gives_no_orders_publishes_it_confirms_nothing() -> None:
    term_fence = acting(5)
    kept(term_fence, (5, 1), (5, 2))
    assert kept(term_fence, *((6, serial) for serial in range(20))) == ["6.19", "5.2", "5.1"]
    assert kept(term_fence, (7, 0)) == ["7.0", "5.2", "5.1"], "nor does the next term"


def test_the_last_word_of_an_acting_coordinator_is_confirmed_when_another_takes_over() -> None:
    term_fence = acting(5)
    kept(term_fence, (5, 1), (5, 2))
    assert term_fence.check(order(6, 1))
    assert kept(term_fence, (6, 0), (6, 1), (6, 2)) == ["6.2", "6.1", "6.0"]


def test_the_proof_of_a_term_is_kept_with_the_term() -> None:
    term_fence = TermFence()
    term_fence.hear(7, b"seven")
    term_fence.hear(5, b"five")
    assert (term_fence.term, term_fence.term_proof) == (7, b"seven")
    term_fence.keep(msgspec.structs.replace(checkpoint(8, 0), term_proof=b"eight"), b"")
    assert term_fence.term_proof == b"eight"
    term_fence.check(msgspec.structs.replace(order(9, 1), term_proof=b"nine"))
    assert term_fence.term_proof == b"nine"
