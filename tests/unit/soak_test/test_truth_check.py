from soak_test.true_poses import JudgedBelief
from soak_test.truth_check import Truth
from tests.unit.soak_test.hear import at, belief, place

ORIGIN = (0.0, 0.0, 0.0)


def test_the_nearest_place_is_judged() -> None:
    check = Truth()
    places = place(0, 0.6, (9.0, 0.0, 0.0)), place(1, 0.4)
    check.judge(JudgedBelief(at(1.1), belief(1, *places), (1.0, 0.0, 0.0)))
    check.judge(JudgedBelief(at(2.1), belief(2, place(1, 1.0)), (0.1, 0.0, 0.0)))
    tracked, sure = check.verdicts()
    assert tracked.kept is True
    assert tracked.figures["share"] == 1.0
    assert sure.kept is True


def test_a_place_with_the_wrong_heading_is_not_where_the_robot_is() -> None:
    check = Truth()
    check.judge(JudgedBelief(at(1.1), belief(1, place(0, 0.5), place(1, 0.5)), (0.0, 0.0, 1.0)))
    assert check.verdicts()[0].kept is False


def test_to_be_sure_of_a_wrong_place_is_noticed() -> None:
    check = Truth()
    wrong, right = place(0, 0.95, (5.0, 0.0, 0.0)), place(1, 0.05)
    check.judge(JudgedBelief(at(1.1), belief(7, wrong, right), ORIGIN))
    tracked, sure = check.verdicts()
    assert tracked.kept is True
    assert [broken.what for broken in sure.breaks] == ["5.0 m off at step 7"]


def test_a_belief_that_no_worker_has_reported_to_is_not_judged() -> None:
    check = Truth()
    far = place(0, 0.5, (5.0, 0.0, 0.0)), place(1, 0.5, (9.0, 0.0, 0.0))
    check.judge(JudgedBelief(at(1.1), belief(1, *far, missing=("c0", "c1")), ORIGIN))
    assert check.verdicts()[0].figures["blind"] == 1
    check.judge(JudgedBelief(at(1.1), belief(1, *far, missing=("c0",)), ORIGIN))
    assert check.verdicts()[0].figures["share"] == 0.0
