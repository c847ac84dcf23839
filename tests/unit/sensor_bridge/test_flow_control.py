import pytest

from clustermcl.protocol.steps import Scan
from clustermcl.sensor_bridge import flow_control
from tests.unit.sensor_bridge.test_step_maker import a_maker, driving

SECOND = 1_000_000_000
LATER = 10 * flow_control.STANDING_STEP_NS


def flow_after(
    *sent: int, believed: int | None = None, searching: bool = False, rate: float = 1.0
) -> flow_control.FlowControl:
    """After these steps, and the belief of one of them, all at time 0."""
    flow = flow_control.FlowControl(rate)
    for step in sent:
        flow.on_sent(step, 0)
    if believed is not None:
        flow.on_belief(believed, 1, 0, searching=searching)
    return flow


def undecided(steps: int) -> flow_control.FlowControl:
    return flow_after(*range(steps + 1), believed=0)


def test_a_belief_of_a_deposed_coordinator_is_ignored() -> None:
    flow = flow_after(5, rate=0.0)
    flow.on_belief(4, 2, 0, searching=False)
    flow.on_belief(5, 1, 0, searching=True)
    assert flow.waits
    assert not flow.wants_standing_step(LATER)
    flow.on_belief(5, 2, 0, searching=True)
    assert not flow.waits


def test_in_lockstep_a_step_without_a_belief_is_repeated() -> None:
    flow = flow_after(5, rate=0.0)
    assert not flow.is_resend_due(flow_control.RESEND_AFTER_NS - 1)
    assert flow.is_resend_due(flow_control.RESEND_AFTER_NS)
    assert not flow.is_resend_due(flow_control.RESEND_AFTER_NS + 1)


def test_back_pressure_begins_at_the_limit_of_undecided_steps() -> None:
    assert not undecided(flow_control.MAX_UNDECIDED - 1).is_full(SECOND // 2)
    flow = undecided(flow_control.MAX_UNDECIDED)
    assert flow.is_full(SECOND // 2)
    flow.on_belief(1, 1, SECOND // 2, searching=False)
    assert not flow.is_full(SECOND // 2)
    flow = undecided(2 * flow_control.MAX_UNDECIDED)
    flow.on_belief(2 * flow_control.MAX_UNDECIDED, 1, 1, searching=False)
    assert not flow.is_full(2), "a belief decides all earlier steps, too"


def test_without_a_coordinator_there_is_no_back_pressure() -> None:
    assert not flow_after(*range(10)).is_full(1), "there was none yet"
    assert undecided(9).is_full(flow_control.OUTAGE_NS - 1)
    assert not undecided(9).is_full(flow_control.OUTAGE_NS), "there is none any more"


def test_scans_held_back_are_counted_and_step_numbers_have_no_gap() -> None:
    maker, made = a_maker(), list[Scan | None]()
    for number, reading in enumerate(driving(0.0, 1.0, 2.0, 2.1, 3.0)):
        maker.gate.is_held = number in (1, 2)
        made.append(maker.on_reading(reading))
    steps = [scan and (scan.step, scan.odom_from_robot[0]) for scan in made]
    assert steps == [(0, 0.0), None, None, (1, 2.1), (2, 3.0)]
    assert maker.gate.held_back == 2


@pytest.mark.parametrize(
    ("believed", "searching", "at_ns", "wants"),
    [
        (3, True, LATER, True),
        (3, False, LATER, False),
        (2, True, LATER, False),
        (None, True, LATER, False),
        (3, True, flow_control.STANDING_STEP_NS - 1, False),
        (3, True, flow_control.STANDING_STEP_NS, True),
    ],
)
def test_a_standing_robot_makes_a_step_in_a_search_some_time_after_the_last_one_is_decided(
    believed: int | None, searching: bool, at_ns: int, wants: bool
) -> None:
    flow = flow_after(3, believed=believed, searching=searching)
    assert flow.wants_standing_step(at_ns) == wants


def test_with_a_new_map_a_standing_robot_makes_steps_until_one_of_the_map_is_decided() -> None:
    flow = flow_after(3, believed=3)
    flow.on_new_map()
    assert flow.wants_standing_step(LATER)
    for step in (4, 5, 6):
        flow.on_sent(step, 0)
        flow.on_belief(3, 1, 0, searching=False)
        assert flow.wants_standing_step(LATER)
    flow.on_belief(6, 1, 0, searching=False)
    assert not flow.wants_standing_step(LATER)
