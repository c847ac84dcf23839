from soak_test.availability import Availability
from soak_test.pose_checks import Ages, Answered
from soak_test.schedule import Kind
from tests.unit.soak_test.hear import answered, fault, unanswered


def test_questions_in_an_outage_are_told_but_do_not_count() -> None:
    availability = Availability()
    check = Answered(availability)
    for second in range(10):
        check.on_question(answered(second, stamp_s=second, age_s=0.0))
    check.on_question(unanswered(20.0))
    availability.fault(fault(Kind.ROUTER_KILLED, 19.9))
    verdict = check.verdict()
    assert verdict.kept is True
    assert verdict.figures["share"] == 1.0
    assert verdict.figures["share_with_outages"] == 10 / 11


def test_one_of_a_thousand_may_be_unanswered_and_no_more() -> None:
    check = Answered(Availability())
    for _ in range(1998):
        check.on_question(answered(1.0, stamp_s=1.0, age_s=0.0))
    for _ in range(2):
        check.on_question(unanswered(50.0))
    assert check.verdict().kept is True
    check.on_question(unanswered(51.0))
    assert check.verdict().kept is False


def test_nothing_asked_keeps_no_promise() -> None:
    assert Answered(Availability()).verdict().kept is False


def test_old_data_called_fresh_is_noticed() -> None:
    check = Ages(stale_after_s=1.0)
    check.on_question(answered(10.0, stamp_s=9.9, age_s=0.1))
    check.on_question(answered(20.0, stamp_s=18.5, age_s=1.5, fresh=False))
    assert [verdict.kept for verdict in check.verdicts()] == [True, True]
    check.on_question(answered(30.0, stamp_s=28.5, age_s=0.0))
    fresh, age = check.verdicts()
    assert fresh.kept is False
    assert "1.50 s old" in fresh.breaks[0].what
    assert age.kept is False


def test_an_age_between_question_and_answer_is_honest() -> None:
    check = Ages(stale_after_s=1.0)
    check.on_question(answered(10.0, stamp_s=9.9, age_s=0.5, took_s=0.9))
    assert check.verdicts()[1].kept is True


def test_data_from_the_future_is_not_honest() -> None:
    check = Ages(stale_after_s=1.0)
    check.on_question(answered(10.0, stamp_s=3610.0, age_s=0.0))
    assert check.verdicts()[1].kept is False
