from soak_test.availability import Availability
from soak_test.kidnap_check import FOUND_WITHIN_S, Kidnappings
from soak_test.schedule import Kind
from soak_test.true_poses import JudgedBelief
from soak_test.truth_check import truth_held
from tests.unit.soak_test.hear import at, belief, fault, place

HERE, ELSEWHERE = (1.0, 2.0, 0.5), (9.0, 2.0, 0.5)


def heard(second: float, *, held: bool, kidnapped: int, blind: bool = False) -> JudgedBelief:
    places = (place(0, 1.0, HERE if held else ELSEWHERE),)
    missing = ("c0",) if blind else ()
    return JudgedBelief(at(second), belief(1, *places, missing=missing), HERE, kidnapped)


def test_from_the_first_scan_elsewhere_until_it_is_found_it_is_looked_for() -> None:
    check = Kidnappings(Availability(), truth_held)
    assert not check.looked_for(heard(1.0, held=False, kidnapped=0)), "it was not lifted"
    assert check.looked_for(heard(2.0, held=False, kidnapped=1))
    assert check.looked_for(heard(2.5, held=True, kidnapped=1, blind=True)), "by chance"
    assert check.looked_for(heard(3.0, held=False, kidnapped=1))
    assert not check.looked_for(heard(6.5, held=True, kidnapped=1))
    assert not check.looked_for(heard(7.0, held=False, kidnapped=1)), "lost again is lost"
    verdict = check.verdict(at(600.0))
    assert verdict.kept is True
    assert verdict.figures == {"found": 1, "longest_s": 4.5, "late": 0}


def test_one_that_is_not_found_in_time_is_late() -> None:
    check = Kidnappings(Availability(), truth_held)
    assert check.looked_for(heard(2.0, held=False, kidnapped=1))
    assert check.looked_for(heard(2.5 + FOUND_WITHIN_S, held=False, kidnapped=1))
    assert not check.looked_for(heard(3.0 + FOUND_WITHIN_S, held=True, kidnapped=1))
    verdict = check.verdict(at(600.0))
    assert verdict.kept is False
    assert [late.what for late in verdict.breaks] == ["not found for 61.0 s"]


def test_one_that_is_never_found_is_late_once_there_was_time() -> None:
    for now_s, kept in ((3.0, None), (600.0, False)):
        check = Kidnappings(Availability(), truth_held)
        check.looked_for(heard(2.0, held=False, kidnapped=1))
        assert check.verdict(at(now_s)).kept is kept


def test_there_is_more_time_if_the_coordinator_dies_meanwhile() -> None:
    availability = Availability()
    check = Kidnappings(availability, truth_held)
    check.looked_for(heard(2.0, held=False, kidnapped=1))
    availability.fault(fault(Kind.COORDINATOR_KILLED, 3.0))
    check.looked_for(heard(3.0 + FOUND_WITHIN_S, held=True, kidnapped=1))
    assert check.verdict(at(600.0)).kept is True


def test_one_that_is_lifted_again_is_looked_for_anew() -> None:
    check = Kidnappings(Availability(), truth_held)
    check.looked_for(heard(2.0, held=False, kidnapped=1))
    check.looked_for(heard(20.0, held=False, kidnapped=2))
    assert check.looked_for(heard(40.0, held=False, kidnapped=2))
    assert not check.looked_for(heard(45.0, held=True, kidnapped=2))
    assert check.verdict(at(600.0)).figures == {"found": 1, "longest_s": 25.0, "late": 0}
