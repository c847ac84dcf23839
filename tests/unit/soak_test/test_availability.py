from soak_test.availability import Availability
from soak_test.schedule import Kind
from tests.unit.soak_test.hear import at, fault


def restarted(*, gone_s: float = 1.0) -> Availability:
    """A coordinator was killed at 10 s and is back after some time."""
    availability = Availability()
    availability.fault(fault(Kind.COORDINATOR_KILLED, 10.0))
    availability.token(at(10.01), alive=False)
    availability.token(at(10.01 + gone_s), alive=True)
    return availability


def test_nobody_can_be_reached_until_the_next_coordinator_is_there() -> None:
    availability = restarted()
    assert availability.reachable(at(9.0), at(9.9))
    assert not availability.reachable(at(9.5), at(10.5))
    assert not availability.reachable(at(11.0), at(11.1))
    assert availability.reachable(at(13.0), at(13.1))


def test_an_outage_that_lasts_too_long_is_no_excuse_in_the_end() -> None:
    availability = restarted(gone_s=20.0)
    assert availability.reachable(at(25.0), at(25.1))
    verdict = availability.verdict(at(60.0))
    assert verdict.kept is False
    assert "20.0 s" in verdict.breaks[0].what


def test_a_coordinator_that_is_back_in_time_keeps_the_promise() -> None:
    assert restarted().verdict(at(60.0)).kept is True


def test_a_coordinator_that_goes_without_a_fault_breaks_it() -> None:
    availability = Availability()
    availability.token(at(10.0), alive=False)
    availability.token(at(10.5), alive=True)
    assert "without a fault" in availability.verdict(at(60.0)).breaks[0].what


def test_who_is_frozen_cannot_be_reached_though_its_token_is_there() -> None:
    availability = Availability()
    availability.fault(fault(Kind.COORDINATOR_FROZEN, 10.0, 3.0))
    assert not availability.reachable(at(12.5), at(12.6))
    assert availability.reachable(at(14.5), at(14.6))


def test_faults_of_the_network_excuse_what_happens_shortly_after() -> None:
    availability = Availability()
    availability.fault(fault(Kind.SLOW_NETWORK, 10.0, 5.0))
    assert availability.cut_off(at(12.0), at(12.1))
    assert availability.cut_off(at(15.5), at(16.0))
    assert not availability.cut_off(at(30.0), at(31.0))
