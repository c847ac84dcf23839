"""The real bridge as a process, and a robot for it."""

from collections.abc import Callable
from itertools import chain

import pytest

from clustermcl.runtime.settings import ZenohSettings
from clustermcl.runtime.supervisor import python_module
from tests.integration.conftest import OpenClient, StartProcess
from tests.integration.sensor_bridge.robot import Robot
from tests.integration.waiting import wait_until

StartBridge = Callable[..., Robot]


@pytest.fixture
def start_bridge(
    router: ZenohSettings, start_process: StartProcess, open_client: OpenClient
) -> StartBridge:
    """Starts a bridge with a map, ``zenoh`` or a file; returns a robot once it answers."""

    def start(grid_map: object = "zenoh", landmarks: object = "") -> Robot:
        values = (f"zenoh.router={router.router}", f"bridge.map={grid_map}")
        words = [("--set", value) for value in (*values, f"bridge.landmarks={landmarks}")]
        process = start_process(python_module("clustermcl.sensor_bridge", *chain(*words)))
        robot = Robot(open_client(), process)
        wait_until(lambda: robot.dropped() is not None)
        return robot

    return start
