"""The lifecycle of a managed node."""

import pytest

from clustermcl.ros2.lifecycle import TRANSITION_GRAPH, Lifecycle, State


def test_a_node_is_configured_activated_paused_and_reset() -> None:
    lifecycle = Lifecycle()
    states = []
    for number in (1, 3, 4, 3, 4, 2, 1, 3, 7):
        assert len(lifecycle.change(number)) == 2
        states.append(lifecycle.state.label)
    assert states == [
        *("inactive", "active", "inactive", "active", "inactive", "unconfigured"),
        *("inactive", "active", "finalized"),
    ]
    assert lifecycle.available() == []


def test_each_lifecycle_change_is_two_transitions_with_the_numbers_of_ros() -> None:
    steps = Lifecycle().change(1)
    assert [(one.number, one.label) for one in steps] == [
        (1, "configure"),
        (10, "transition_success"),
    ]
    assert [(one.start.value, one.goal.value) for one in steps] == [(1, 10), (10, 2)]


@pytest.mark.parametrize("number", [0, 2, 3, 4, 6, 7, 99])
def test_a_transition_that_the_state_does_not_allow_has_no_effect(number: int) -> None:
    lifecycle = Lifecycle()
    assert lifecycle.change(number) == ()
    assert lifecycle.state is State.UNCONFIGURED


def test_a_label_takes_precedence_over_a_number() -> None:
    lifecycle = Lifecycle()
    assert lifecycle.change(99, "configure")
    assert lifecycle.change(0, "shutdown")
    assert lifecycle.state is State.FINALIZED


def test_the_available_transitions_depend_on_the_state() -> None:
    lifecycle = Lifecycle()
    assert [one.label for one in lifecycle.available()] == ["configure", "shutdown"]
    lifecycle.change(1)
    assert [one.number for one in lifecycle.available()] == [2, 3, 6]
    assert len(TRANSITION_GRAPH) == len(set(TRANSITION_GRAPH)) == 12
