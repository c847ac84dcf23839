from soak_test.availability import Availability
from soak_test.delay_check import Delays
from soak_test.schedule import Kind
from tests.unit.soak_test.hear import at, fault


def test_the_slowest_of_a_hundred_and_the_slowest_are_told() -> None:
    check = Delays(Availability(), within_s=0.1, longest_s=1.0)
    for step in range(200):
        check.scan(at(step), step)
        check.believed(at(step + (0.5 if step == 7 else 0.02)), step)
    share, longest = check.verdicts()
    assert share.kept is True
    assert longest.kept is True
    assert longest.figures["longest_s"] == 0.5


def test_a_scan_said_again_makes_nothing_faster() -> None:
    check = Delays(Availability(), within_s=0.1, longest_s=1.0)
    check.scan(at(0.0), 1)
    check.scan(at(1.9), 1)
    check.believed(at(2.0), 1)
    assert [verdict.kept for verdict in check.verdicts()] == [False, False]


def test_an_outage_does_not_count() -> None:
    availability = Availability()
    availability.fault(fault(Kind.COORDINATOR_KILLED, 10.0))
    check = Delays(availability, within_s=None, longest_s=1.0)
    check.scan(at(1.0), 1)
    check.believed(at(1.1), 1)
    check.scan(at(9.9), 2)
    check.believed(at(13.0), 2)
    share, longest = check.verdicts()
    assert share.kept is None
    assert longest.kept is True
