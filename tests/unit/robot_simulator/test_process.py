import argparse

import pytest

from process_runtime.main import Invocation
from process_runtime.settings import Settings
from process_runtime.stop import StopFlag
from protocol.errors import SettingsError
from robot_simulator.process import run_simulator


@pytest.mark.parametrize("source", ["robot.log", "zenoh"])
def test_the_simulator_simulates_nothing_else(source: str) -> None:
    arguments = argparse.Namespace(source=source)
    with pytest.raises(SettingsError, match=f"'{source}' is not a simulation"):
        run_simulator(Invocation("robot_simulator", Settings(), arguments, StopFlag()))
