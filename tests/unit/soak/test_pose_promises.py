import pytest

from tests.soak.promises import BACK_WITHIN_S, AgeTrue, Answered
from tests.soak.schedule import Kind
from tests.unit.soak.made_up import answered, fault, outages, unanswered


def test_a_question_during_an_outage_is_counted_apart() -> None:
    known = outages()
    promise = Answered(known)
    for second in range(10):
        promise.on_question(answered(second, stamp_s=second, age_s=0.0))
    promise.on_question(unanswered(20.0))
    known.faults.append(fault(Kind.ROUTER_KILLED, 19.9))
    verdict = promise.verdict()
    assert verdict.kept is True
    assert verdict.figures["share"] == 1.0
    assert verdict.figures["share_with_outages"] == 10 / 11


@pytest.mark.parametrize(("late_s", "kept"), [(-0.1, True), (0.1, False)])
def test_an_outage_that_outlasts_its_bound_excuses_nothing(late_s: float, kept: bool) -> None:
    promise = Answered(outages(fault(Kind.COORDINATOR_FROZEN, 10.0, 3.0)))
    promise.on_question(answered(9.0, stamp_s=9.0, age_s=0.0))
    promise.on_question(unanswered(13.0 + BACK_WITHIN_S + late_s))
    assert promise.verdict().kept is kept


def test_one_question_in_a_thousand_may_go_unanswered_and_no_more() -> None:
    promise = Answered(outages())
    for _ in range(1998):
        promise.on_question(answered(1.0, stamp_s=1.0, age_s=0.0))
    for _ in range(2):
        promise.on_question(unanswered(50.0))
    assert promise.verdict().kept is True
    promise.on_question(unanswered(51.0))
    assert promise.verdict().kept is False


def test_without_a_question_no_promise_is_kept() -> None:
    assert Answered(outages()).verdict().kept is False
    assert AgeTrue(stale_after_s=1.0).verdict().kept is False


def test_old_data_called_fresh_is_noticed() -> None:
    promise = AgeTrue(stale_after_s=1.0)
    promise.on_question(answered(10.0, stamp_s=9.9, age_s=0.1))
    promise.on_question(answered(20.0, stamp_s=18.5, age_s=1.5, fresh=False))
    assert promise.verdict().kept is True
    promise.on_question(answered(30.0, stamp_s=28.5, age_s=1.5))
    verdict = promise.verdict()
    assert [broken.what for broken in verdict.breaks] == ["fresh, but 1.50 s old"]
    assert verdict.figures["wrong_fresh"] == 1


def test_an_age_between_question_and_answer_is_true_and_one_outside_is_not() -> None:
    promise = AgeTrue(stale_after_s=1.0)
    promise.on_question(answered(10.0, stamp_s=9.9, age_s=0.5, took_s=0.9))
    assert promise.verdict().kept is True
    promise.on_question(answered(10.0, stamp_s=3610.0, age_s=0.0))
    assert promise.verdict().kept is False
