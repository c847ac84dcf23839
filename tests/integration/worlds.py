"""The world in which the robot of a stack drives."""

from process_runtime.settings import Settings
from process_runtime.sources import Simulated, parsed_source
from robot_simulator.source import simulated_world
from robot_simulator.worlds.world import World


def world_of(settings: Settings) -> World:
    robot = parsed_source(settings.bridge.source)
    assert isinstance(robot, Simulated)
    return simulated_world(robot)
