from protocol.job_events import Ended, JobEvents, NumberedEvent
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


def test_a_place_that_goes_is_named_with_the_reason() -> None:
    check = Places(2)
    check.on_belief(at(1.0), belief(1, place(0, 0.5), place(1, 0.5, (3.0, 4.0, 0.0))))
    merged = Ended("c1", "merged", ("c0",), 0.5)
    event = NumberedEvent(number=7, step=2, stamp_ns=at(2.0), event=merged)
    check.on_events(JobEvents(sender="coordinator", events=(event,)))
    check.on_belief(at(2.0), belief(2, place(0, 1.0)))
    check.on_belief(at(3.0), belief(3, place(0, 1.0)))
    verdict = check.verdict()
    assert verdict.kept is False
    assert [broken.what for broken in verdict.breaks] == ["1 at step 2; c1 merged into c0 (0.5)"]
    assert verdict.figures["short"] == 2


def test_a_place_that_goes_without_a_reason_is_named_as_such() -> None:
    check = Places(2)
    check.on_belief(at(1.0), belief(1, place(0, 0.5), place(1, 0.5)))
    check.on_belief(at(2.0), belief(2, place(0, 1.0)))
    (broken,) = check.verdict().breaks
    assert broken.what == "1 at step 2; c1 has gone, nobody said why"
