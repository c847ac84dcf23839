from collections.abc import Iterable

from soak_test.availability import Availability
from soak_test.schedule import Kind
from soak_test.step_check import Steps
from tests.unit.soak_test.hear import at, belief, fault, place


def heard(steps: Iterable[int], availability: Availability | None = None) -> Steps:
    """A belief each second, of these steps."""
    check = Steps(availability or Availability())
    for second, step in enumerate(steps):
        check.on_belief(at(second), belief(step, place(0, 1.0)))
    return check


def test_each_step_once_keeps_both_promises() -> None:
    assert [verdict.kept for verdict in heard([4, 5, 6]).verdicts()] == [True, True]


def test_a_step_that_is_missing_is_lost() -> None:
    lost, doubled = heard([1, 2, 5]).verdicts()
    assert lost.kept is False
    assert lost.breaks[0].what.startswith("2 of steps 3 to 4")
    assert doubled.kept is True


def test_steps_that_come_later_are_not_lost() -> None:
    availability = Availability()
    availability.fault(fault(Kind.COORDINATOR_KILLED, 1.5))
    lost, doubled = heard([1, 2, 5, 3, 4], availability).verdicts()
    assert lost.figures["lost_without_coordinator"] == 0
    assert doubled.kept is True


def test_what_a_network_that_is_down_loses_is_excused_and_told() -> None:
    availability = Availability()
    availability.fault(fault(Kind.ROUTER_KILLED, 1.5))
    lost, _ = heard([1, 2, 5], availability).verdicts()
    assert lost.kept is True
    assert lost.figures["lost_without_network"] == 2


def test_a_step_believed_again_without_a_fault_is_doubled() -> None:
    assert heard([1, 2, 2]).verdicts()[1].kept is False


def test_a_new_coordinator_may_say_the_same_again_but_nothing_else() -> None:
    availability = Availability()
    availability.fault(fault(Kind.COORDINATOR_KILLED, 1.5))
    check = heard([1, 2, 2], availability)
    assert check.verdicts()[1].kept is True
    assert check.verdicts()[1].figures["said_again"] == 1
    check.on_belief(at(4.0), belief(2, place(0, 0.5), place(1, 0.5)))
    assert check.verdicts()[1].kept is False
