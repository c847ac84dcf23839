from process_runtime.settings import BridgeSettings
from sensor_bridge.motion_gate import MotionGate
from sensor_bridge.standing_robot import EVERY_NS, StandingRobot

LATER = 10 * EVERY_NS


def after_step(step: int, *, searching: bool, believed: int | None = None) -> StandingRobot:
    robot = StandingRobot()
    robot.step_sent(step, now_ns=0)
    robot.believed(step if believed is None else believed, 1, searching=searching)
    return robot


def test_before_anything_is_believed_nothing_is_wanted() -> None:
    robot = StandingRobot()
    robot.step_sent(0, now_ns=0)
    assert not robot.wants_step(LATER)


def test_while_it_is_searched_for_the_next_step_is_wanted_after_the_belief_of_the_last() -> None:
    assert after_step(3, searching=True).wants_step(LATER)
    assert not after_step(3, searching=True, believed=2).wants_step(LATER)
    assert not after_step(3, searching=False).wants_step(LATER)


def test_steps_of_a_standing_robot_come_one_by_one() -> None:
    robot = after_step(3, searching=True)
    assert not robot.wants_step(EVERY_NS - 1)
    assert robot.wants_step(EVERY_NS)


def test_a_coordinator_that_was_taken_over_from_has_nothing_to_say() -> None:
    robot = StandingRobot()
    robot.step_sent(3, now_ns=0)
    robot.believed(3, 2, searching=False)
    robot.believed(3, 1, searching=True)
    assert not robot.wants_step(LATER)


def test_with_a_new_map_steps_are_wanted_until_one_of_it_is_believed() -> None:
    robot = after_step(3, searching=False)
    robot.new_map()
    assert robot.wants_step(LATER)
    for step in (4, 5, 6):
        robot.step_sent(step, now_ns=0)
        robot.believed(3, 1, searching=False)
        assert robot.wants_step(LATER)
    robot.believed(6, 1, searching=False)
    assert not robot.wants_step(LATER)


def test_a_robot_stands_that_has_moved_less_than_a_quarter_of_the_gate() -> None:
    gate = MotionGate(BridgeSettings(gate_distance_m=0.2, gate_turn_rad=0.2))
    assert not gate.has_hardly_moved((0.0, 0.0, 0.0))
    assert gate.on_scan((1.0, 0.0, 0.0))
    assert gate.has_hardly_moved((1.04, 0.0, 0.04))
    assert not gate.has_hardly_moved((1.06, 0.0, 0.0))
    assert not gate.has_hardly_moved((1.0, 0.0, -0.06))
    gate.begin_anew()
    assert gate.on_scan((1.0, 0.0, 0.0))
