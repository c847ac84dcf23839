import pytest

from clustermcl.protocol.errors import OldTermError
from clustermcl.worker.worker import KEPT_TERMS, TermFence
from tests.unit.coordinator.reports import checkpoint, work_order


def test_a_take_over_or_a_checkpoint_fences_lower_terms() -> None:
    asked, reported = TermFence(), TermFence()
    asked.on_term(7)
    reported.on_checkpoint(checkpoint(7, 0))
    for term_fence in (asked, reported):
        with pytest.raises(OldTermError, match="current term is 7"):
            term_fence.check(work_order(term=6))


def test_all_received_terms_are_known_and_the_last_one_with_a_belief() -> None:
    term_fence = TermFence()
    term_fence.on_checkpoint(checkpoint(5, 1))
    term_fence.on_checkpoint(checkpoint(5, 2))
    term_fence.on_term(9)
    assert term_fence.check(work_order(term=10)), "orders of a new coordinator count from the start"
    term_fence.on_checkpoint(checkpoint(6, 1))
    term_fence.on_checkpoint(checkpoint(10, 1, founded=False))
    assert (term_fence.term, term_fence.terms, term_fence.founded) == (10, (5, 9, 10, 6), 6)


def test_the_last_terms_are_kept() -> None:
    term_fence = TermFence()
    for term in range(1, 100):
        term_fence.on_term(term)
    assert term_fence.terms == tuple(range(100 - KEPT_TERMS, 100))
