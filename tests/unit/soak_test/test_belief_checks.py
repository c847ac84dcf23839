from soak_test.belief_checks import Places, Probabilities
from tests.unit.soak_test.hear import at, belief, place


def test_probabilities_must_sum_to_one() -> None:
    check = Probabilities()
    check.on_belief(at(1.0), belief(1, place(0, 0.25), place(1, 0.75)))
    check.on_belief(at(2.0), belief(2))  # still searching: no places, no sum
    assert check.verdict().kept is True
    check.on_belief(at(3.0), belief(3, place(0, 0.25), place(1, 0.75 + 2e-9)))
    assert check.verdict().kept is False


def test_a_probability_that_is_no_number_is_noticed() -> None:
    check = Probabilities()
    check.on_belief(at(1.0), belief(1, place(0, float("nan"))))
    assert check.verdict().kept is False


def test_places_count_from_when_all_are_found() -> None:
    check = Places(2)
    check.on_belief(at(1.0), belief(1, place(0, 1.0)))
    assert not check.complete
    check.on_belief(at(2.0), belief(2, place(0, 0.5), place(1, 0.5)))
    assert check.complete
    assert check.verdict().kept is True


def test_a_place_that_goes_is_named_with_the_next_to_it() -> None:
    check = Places(2)
    check.on_belief(at(1.0), belief(1, place(0, 0.5), place(1, 0.5, (3.0, 4.0, 0.0))))
    check.on_belief(at(2.0), belief(2, place(0, 1.0)))
    check.on_belief(at(3.0), belief(3, place(0, 1.0)))
    verdict = check.verdict()
    assert verdict.kept is False
    assert [broken.what for broken in verdict.breaks] == [
        "1 at step 2; c1 has gone, 5.00 m from another"
    ]
    assert verdict.figures["short"] == 2
