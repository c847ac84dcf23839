import pytest

from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.message import Message
from clustermcl.protocol.work import MAX_AHEAD_US, Checkpoint, OrderAnswer, TakeOver, check_term

NOW_NS = 1_795_000_000_000_000_000
NOW_US = NOW_NS // 1_000


def take_over(term: int) -> TakeOver:
    return TakeOver(sender="c", term=term)


@pytest.mark.parametrize(
    ("term", "clock_ns"),
    [(0, NOW_NS), (NOW_US + MAX_AHEAD_US, NOW_NS), (NOW_US + MAX_AHEAD_US + 1, NOW_NS + 1_000)],
)
def test_past_terms_and_terms_of_other_clocks_are_accepted(term: int, clock_ns: int) -> None:
    check_term(take_over(term), clock_ns)
    check_term(take_over(NOW_US), clock_ns=0)  # of a machine whose clock starts in 1970
    assert term < 2**53


@pytest.mark.parametrize(
    "message",
    [
        take_over(2**53 - 1),
        Checkpoint(sender="c", term=2**53 - 1, serial=0, step=-1, founded=False, state=b""),
        OrderAnswer(sender="w", term=2**53 - 1, order=0, jobs=()),
    ],
)
def test_a_term_too_far_ahead_of_the_clock_is_refused(message: Message) -> None:
    with pytest.raises(MalformedMessageError, match=r"\d+ years ahead of the clock") as refused:
        check_term(message, NOW_NS)  # type: ignore[arg-type] # one that has a term
    assert refused.value.cause == f"malformed {type(message).__name__}: term far ahead"
