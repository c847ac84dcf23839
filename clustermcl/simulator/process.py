"""The process of a simulated robot, in the place of a sensor bridge."""

import argparse
import logging
from collections.abc import Iterator
from dataclasses import replace

from clustermcl.link.node import Node
from clustermcl.link.wire import Asked
from clustermcl.protocol import keys
from clustermcl.protocol.answers import CommandDone, Kidnap
from clustermcl.protocol.codec import decode
from clustermcl.protocol.errors import SettingsError
from clustermcl.protocol.steps import Observation, Reading, Scan, TruePose
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.runtime.main import Invocation, process_main
from clustermcl.runtime.memory import trim_heap
from clustermcl.runtime.sources import Simulated, parsed_source
from clustermcl.sensor_bridge.process import OnStep, serve_robot
from clustermcl.sensor_bridge.recorded import Source
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.worlds.catalogue import simulated_world

_log = logging.getLogger(__name__)


def main() -> None:
    process_main(
        "simulator",
        run_simulator,
        describe="Simulated robot: drives in a world, and publishes steps like a sensor bridge.",
        add_arguments=_add_arguments,
    )


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--map", metavar="FILE", help="map to localize in (default: the world's own)")
    add("--steps", type=int, metavar="N", help="stop after N steps")


def run_simulator(invocation: Invocation) -> None:
    settings, arguments = invocation.settings, invocation.arguments
    robot = parsed_source(settings.bridge.source)
    if not isinstance(robot, Simulated):
        problem = f"bridge.source = {settings.bridge.source!r} is not a simulation"
        raise SettingsError(f"{problem}: give sim:WORLD or sim:MAP.yaml")
    world = simulated_world(robot)
    simulation = Simulation(world, settings.seed)
    trim_heap()  # of what its roads and distances were computed from
    made, here = 0, simulation.map_from_robot

    def readings() -> Iterator[Reading | Observation]:
        nonlocal here
        while made != arguments.steps:
            tick = next(simulation)
            here = tick.map_from_robot
            yield from tick.messages

    def extend(node: Node) -> OnStep:
        truth, last_id = node.publisher(keys.TRUTH), ""

        def kidnap(asked: Asked) -> None:
            """Carry out a command; a repeated one has no effect."""
            nonlocal last_id
            command = decode(asked.payload, Kidnap)
            if command.command_id != last_id:
                last_id = command.command_id
                x, y, heading = simulation.kidnap(command.pose)
                _log.info("the robot was kidnapped to (%.2f, %.2f) m, %.2f rad", x, y, heading)
            asked.answer(CommandDone(sender=node.name))

        node.serve(keys.KIDNAP, kidnap)

        def on_step(scan: Scan) -> None:
            nonlocal made
            made += 1
            floor, there = world.map.floors.on_floor(here)  # a scan's step is made in its tick
            truth.put(TruePose(sender=node.name, step=scan.step, pose=there, floor=floor))

        return on_step

    grid_map = load_map(arguments.map) if arguments.map else world.map
    for remark in () if arguments.map else grid_map.remarks:
        _log.warning("map: %s", remark)
    source = Source(readings(), arguments.steps)
    serve_robot(invocation, grid_map.with_landmarks(world.landmarks), source, extend)


def run_with_defaults(invocation: Invocation) -> None:
    """Simulate until the process is stopped, as the program does without arguments of its own."""
    arguments = argparse.Namespace(map=None, steps=None)
    run_simulator(replace(invocation, arguments=arguments))
