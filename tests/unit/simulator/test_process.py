import argparse
from unittest.mock import Mock

import pytest

from clustermcl.protocol.advice import Advice
from clustermcl.protocol.errors import SettingsError
from clustermcl.runtime.main import Invocation
from clustermcl.runtime.settings import BridgeSettings, Settings
from clustermcl.runtime.stop import StopFlag
from clustermcl.simulator.process import ASK_STEPS, Follower, run_simulator
from tests.unit.evaluation.places import belief, place, straight_way


@pytest.mark.parametrize("source", ["robot.log", "zenoh"])
def test_the_simulator_refuses_another_source_than_a_simulation(source: str) -> None:
    settings = Settings(bridge=BridgeSettings(source=source))
    with pytest.raises(SettingsError, match=f"'{source}' is not a simulation"):
        run_simulator(Invocation("simulator", settings, argparse.Namespace(), StopFlag()))


def test_a_robot_on_an_advised_way_asks_again_after_some_steps_if_places_are_gone() -> None:
    node, simulation = Mock(), Mock()
    simulation.robot.follows = False
    follower = Follower(simulation, node)
    follower.truths.append((3, (0.0, 0.0, 0.0)))
    _, _, on_belief = node.subscribe.call_args.args

    def count_asked(step: int, places: int = 3) -> int:
        on_belief(belief(step, "ambiguous", *[place(1.0 / places)] * places), Mock())
        return int(node.ask.call_count)

    assert count_asked(3) == 1
    assert count_asked(4) == 1, "the answer is still missing"
    _, _, on_advice, _ = node.ask.call_args.args
    on_advice(Advice(sender="w", step=3, ways=(straight_way(5.8),)))
    simulation.robot.follows = True
    assert count_asked(3 + ASK_STEPS - 1, places=2) == 1
    assert count_asked(3 + ASK_STEPS, places=3) == 1
    assert count_asked(3 + ASK_STEPS, places=2) == 2
