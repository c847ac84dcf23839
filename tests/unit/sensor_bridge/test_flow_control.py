from protocol.steps import Scan
from sensor_bridge.flow_control import MOST_WAITING, OUTAGE_NS, FlowControl
from tests.unit.sensor_bridge.test_step_maker import a_maker, driving

SECOND = 1_000_000_000


def waiting(steps: int, *, believed_ns: int | None = 0) -> FlowControl:
    flow = FlowControl()
    flow.step_sent(0)
    if believed_ns is not None:
        flow.believed(0, believed_ns)
    for step in range(1, steps + 1):
        flow.step_sent(step)
    return flow


def test_steps_that_wait_for_their_beliefs_are_few() -> None:
    assert not waiting(MOST_WAITING - 1).is_full(SECOND // 2)
    flow = waiting(MOST_WAITING)
    assert flow.is_full(SECOND // 2)
    flow.believed(1, SECOND // 2)
    assert not flow.is_full(SECOND // 2)


def test_a_belief_answers_all_steps_before_it_too() -> None:
    flow = waiting(2 * MOST_WAITING)
    flow.believed(2 * MOST_WAITING, 1)
    assert not flow.is_full(2)


def test_without_a_coordinator_steps_continue() -> None:
    assert not waiting(9, believed_ns=None).is_full(1), "nobody ever has"
    assert waiting(9).is_full(OUTAGE_NS - 1)
    assert not waiting(9).is_full(OUTAGE_NS), "nobody does any more"


def test_scans_that_are_held_back_are_counted_and_leave_no_number_out() -> None:
    maker, made = a_maker(), list[Scan | None]()
    for number, reading in enumerate(driving(0.0, 1.0, 2.0, 2.1, 3.0)):
        maker.hold(number in (1, 2))
        made.append(maker.on_reading(reading))
    steps = [scan and (scan.step, scan.odom_from_robot[0]) for scan in made]
    assert steps == [(0, 0.0), None, None, (1, 2.1), (2, 3.0)]
    assert maker.held_back == 2
