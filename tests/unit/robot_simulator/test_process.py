import argparse
from unittest.mock import Mock

import pytest

from process_runtime.main import Invocation
from process_runtime.settings import BridgeSettings, Settings
from process_runtime.stop import StopFlag
from protocol.advice import Advice, Way
from protocol.answers import Belief
from protocol.errors import SettingsError
from robot_simulator.process import ASK_STEPS, Follower, run_simulator
from tests.unit.evaluation.places import place


@pytest.mark.parametrize("source", ["robot.log", "zenoh"])
def test_the_simulator_refuses_another_source_than_a_simulation(source: str) -> None:
    settings = Settings(bridge=BridgeSettings(source=source))
    with pytest.raises(SettingsError, match=f"'{source}' is not a simulation"):
        run_simulator(Invocation("robot_simulator", settings, argparse.Namespace(), StopFlag()))


def test_a_robot_on_an_advised_way_asks_again_after_some_steps_if_places_are_gone() -> None:
    node, simulation = Mock(), Mock()
    simulation.robot.follows = False
    follower = Follower(simulation, node)
    follower.truths.append((3, (0.0, 0.0, 0.0)))
    _, _, on_belief = node.subscribe.call_args.args

    def count_asked(step: int, places: int = 3) -> int:
        on_belief(_ambiguous(step, places), Mock())
        return int(node.ask.call_count)

    assert count_asked(3) == 1
    assert count_asked(4) == 1, "the answer is still missing"
    _, _, on_advice, _ = node.ask.call_args.args
    on_advice(_advice(3))
    simulation.robot.follows = True
    assert count_asked(3 + ASK_STEPS - 1, places=2) == 1
    assert count_asked(3 + ASK_STEPS, places=3) == 1
    assert count_asked(3 + ASK_STEPS, places=2) == 2


def _ambiguous(step: int, places: int) -> Belief:
    return Belief(
        sender="c", step=step, stamp_ns=step, odom_from_robot=(0.0, 0.0, 0.0), state="ambiguous",
        hypotheses=(place(1.0 / places),) * places, searching=False,
    )  # fmt: skip


def _advice(step: int) -> Advice:
    poses = tuple((0.2 * number, 0.0, 0.0) for number in range(30))
    way = Way(
        poses=poses, length_m=5.8, turn_rad=0.0, information=0.5, sure_probability=0.5,
        sight_bearing_rad=0.0, sight_ranges_m=(),
    )  # fmt: skip
    return Advice(sender="w", step=step, ways=(way,))
