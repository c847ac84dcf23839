from coordinator.failover.checkpoint_series import SIGN_OF_LIFE_NS, CheckpointSeries
from coordinator.failover.term import Term
from protocol.work import Checkpoint

KNOWN = Checkpoint(sender="c", term=8, serial=1, step=0, founded=False, state=b"")


def test_before_it_begins_a_term_is_raised_above_all_that_are_heard_of() -> None:
    term = Term(5, KNOWN)
    assert term.number == 9
    assert not term.hear(9)
    assert term.hear(20)
    assert (term.number, term.outranked_by) == (21, None)


def test_once_begun_it_is_outranked_by_the_highest_that_is_heard_of() -> None:
    term = Term(5, None)
    term.begin()
    assert not term.hear(5)
    assert term.outranked_by is None
    assert not term.hear(7), "it stays as it is"
    term.hear(6)
    assert (term.number, term.outranked_by) == (5, 7)


def test_checkpoints_are_numbered_and_the_last_is_repeated_when_nothing_new_is_said() -> None:
    series = CheckpointSeries("c")
    assert series.sign_of_life(SIGN_OF_LIFE_NS) == []
    first, second = (
        series.next(state, term=1, step=2, founded=True, now_ns=0) for state in (b"one", b"two")
    )
    assert [c.checkpoint.serial for c in (first, second)] == [0, 1]
    assert series.sign_of_life(SIGN_OF_LIFE_NS - 1) == []
    assert series.sign_of_life(SIGN_OF_LIFE_NS) == [second]
    assert series.sign_of_life(SIGN_OF_LIFE_NS + 1) == []
