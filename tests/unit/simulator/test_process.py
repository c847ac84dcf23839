import argparse

import pytest

from clustermcl.protocol.errors import SettingsError
from clustermcl.runtime.main import Invocation
from clustermcl.runtime.settings import BridgeSettings, Settings
from clustermcl.runtime.stop import StopFlag
from clustermcl.simulator.process import run_simulator


@pytest.mark.parametrize("source", ["robot.log", "zenoh"])
def test_the_simulator_refuses_another_source_than_a_simulation(source: str) -> None:
    settings = Settings(bridge=BridgeSettings(source=source))
    with pytest.raises(SettingsError, match=f"'{source}' is not a simulation"):
        run_simulator(Invocation("simulator", settings, argparse.Namespace(), StopFlag()))
