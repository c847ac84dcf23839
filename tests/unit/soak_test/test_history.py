from collections.abc import Mapping

from msgspec.structs import replace

from coordinator.recorder.replay import Believed, CoordinatorActs, Happening
from soak_test.history import History
from tests.unit.soak_test.hear import belief, place

SECOND = 1_000_000_000
ALONE, GOES_ON, AGAIN = range(3)


def said(
    step: int, term: int, *, same: bool | None = True, shares: tuple[float, ...] = (0.5, 0.5)
) -> Believed:
    places = [place(number, share) for number, share in enumerate(shares)]
    return Believed(replace(belief(step, *places, stamp_s=step), term=term), same)


def kept(
    *happened: tuple[float, Happening], heard: Mapping[int, int] | None = None
) -> list[bool | None]:
    history = History(heard or dict.fromkeys(range(10), 99))
    for at_s, happening in happened:
        history.on(int(at_s * SECOND), happening)
    return [verdict.kept for verdict in history.verdicts()]


FIRST = CoordinatorActs("c", 1, None)


def test_a_coordinator_that_carries_on_keeps_all_laws() -> None:
    history = [(0.0, FIRST), (1.0, said(1, 1)), (2.0, said(2, 1))]
    after = [(3.0, CoordinatorActs("c", 5, 2)), (3.0, said(2, 5)), (4.0, said(3, 5))]
    assert kept(*history, *after) == [True, True, True]


def test_one_that_was_frozen_may_decide_for_a_moment_but_not_rule_on() -> None:
    other = [(3.0, CoordinatorActs("c", 5, 1)), (3.0, said(1, 5))]
    woken = [(0.0, FIRST), (1.0, said(1, 1)), (3.5, said(2, 1))]
    assert kept(*woken, *other)[ALONE] is True
    assert kept(*woken, (6.0, said(3, 1)), *other)[ALONE] is False


def test_a_term_that_two_have_had_is_noticed() -> None:
    assert kept((0.0, FIRST), (1.0, CoordinatorActs("d", 1, None)))[ALONE] is False


def test_a_decision_that_is_forgotten_is_noticed() -> None:
    before = [(0.0, FIRST), (1.0, said(1, 1)), (2.0, said(2, 1))]
    anew = (3.0, CoordinatorActs("c", 5, None))
    assert kept(*before, anew, (4.0, said(3, 5)))[GOES_ON] is False
    assert kept(*before, anew, (4.0, said(3, 5, shares=())))[GOES_ON] is False
    killed_at_once = (3.5, CoordinatorActs("d", 6, None))
    assert kept(*before, anew, killed_at_once, (4.0, said(3, 6)))[GOES_ON] is False
    again = (3.0, CoordinatorActs("c", 5, 1))
    assert kept(*before, again, (3.0, said(1, 5)))[GOES_ON] is False


def test_what_nobody_has_heard_binds_nobody() -> None:
    """A coordinator was cut off and decided on until it noticed."""
    before = [(0.0, FIRST), (1.0, said(1, 1)), (2.0, said(2, 1)), (2.5, said(3, 1))]
    after = [(3.0, CoordinatorActs("c", 5, 2)), (3.0, said(2, 5)), (4.0, said(3, 5))]
    assert kept(*before, *after, heard={1: 2})[GOES_ON] is True
    assert kept(*before, *after, heard={1: 3})[GOES_ON] is False


def test_one_that_begins_before_any_worker_is_there_may_be_told_later() -> None:
    before = [(0.0, FIRST), (1.0, said(1, 1)), (2.0, said(2, 1))]
    alone = [(3.0, CoordinatorActs("c", 5, None)), (3.5, said(3, 5, shares=()))]
    assert kept(*before, *alone, (4.0, said(2, 5)), (4.5, said(3, 5)))[GOES_ON] is True
    assert kept(*before, *alone, (4.0, said(1, 5)))[GOES_ON] is False


def test_another_beginning_than_the_last_decision_is_noticed() -> None:
    before, acts = [(0.0, FIRST), (1.0, said(1, 1))], (3.0, CoordinatorActs("c", 5, 1))
    assert kept(*before, acts, (3.0, said(1, 5, shares=(0.4, 0.6))))[GOES_ON] is False


def test_a_replay_that_says_something_else_is_noticed() -> None:
    assert kept((0.0, FIRST), (1.0, said(1, 1, same=False)))[AGAIN] is False
    assert kept((0.0, FIRST), (1.0, said(1, 1, shares=(0.5, 0.4))))[AGAIN] is False
    assert kept((0.0, FIRST), (1.0, said(1, 1, same=None)))[AGAIN] is None
