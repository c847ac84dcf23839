import argparse

import pytest

from process_runtime.main import Invocation
from process_runtime.settings import BridgeSettings, Settings
from process_runtime.stop import StopFlag
from protocol.errors import SettingsError
from robot_simulator.process import run_simulator


@pytest.mark.parametrize("source", ["robot.log", "zenoh"])
def test_the_simulator_refuses_another_source_than_a_simulation(source: str) -> None:
    settings = Settings(bridge=BridgeSettings(source=source))
    with pytest.raises(SettingsError, match=f"'{source}' is not a simulation"):
        run_simulator(Invocation("robot_simulator", settings, argparse.Namespace(), StopFlag()))
