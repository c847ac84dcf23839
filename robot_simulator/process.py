"""The simulator process: a bridge whose robot is simulated."""

import argparse
import logging
from typing import TypeVar

import zenoh

from process_runtime.main import Invocation, process_main
from process_runtime.sources import Simulated, parsed_source
from protocol import keys
from protocol.answers import CommandDone, Drive, Kidnap
from protocol.codec import decode
from protocol.errors import MalformedMessageError, SettingsError
from protocol.steps import Scan, TruePose
from recordings.map_file import load_map
from robot_simulator.simulation import Simulation
from robot_simulator.source import SimulatedSource, simulated_world
from robot_simulator.worlds.world import World
from sensor_bridge.process import serve_robot
from sensor_bridge.source import Extension
from zenoh_link.wire import Asked, Publisher

M = TypeVar("M")

_log = logging.getLogger(__name__)


def main() -> None:
    """Run the simulator."""
    process_main(
        "robot_simulator",
        run_simulator,
        describe="Simulated robot for Cluster-MCL: wanders in a world and publishes steps.",
        add_arguments=_add_arguments,
    )


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--source", metavar="SOURCE", help="sim:WORLD or sim:MAP.yaml (default: bridge.source)"
    )
    parser.add_argument(
        "--map", metavar="FILE", help="map to localize in (default: the world's own)"
    )
    parser.add_argument("--steps", type=int, metavar="N", help="end after N steps")
    parser.add_argument(
        "--kidnap-at", type=int, metavar="STEP", help="lift the robot elsewhere after this step"
    )
    parser.add_argument(
        "--people", type=int, default=0, metavar="N", help="people who walk about near the robot"
    )
    parser.add_argument(
        "--by-hand", action="store_true", help="stand still until somebody drives the robot"
    )


def run_simulator(invocation: Invocation) -> None:
    """Simulate until told to stop.

    Raises:
        SettingsError: the source is no simulation.
        UnknownWorldError: there is no such world.
        MapFileError: the map cannot be used.
        NoRoomError: the robot fits nowhere in it.
        AlreadyRunningError: the robot has a bridge.
    """
    settings, arguments = invocation.settings, invocation.arguments
    world = _world(arguments.source or settings.bridge.source)
    simulation = Simulation(world, settings.seed, people=arguments.people)
    source = SimulatedSource(simulation, steps=arguments.steps, kidnap_at=arguments.kidnap_at)

    if arguments.by_hand:
        source.drive(0.0, 0.0, by_hand=True)

    def extend(session: zenoh.Session) -> Extension:
        truth = Publisher(session, keys.TRUTH)
        operator = _Operator(source, invocation.process)

        def on_step(scan: Scan) -> None:
            pose = source.step_made(scan)
            truth.put(TruePose(sender=invocation.process, step=scan.step, map_from_robot=pose))

        return Extension(on_step, {keys.KIDNAP: operator.kidnap, keys.DRIVE: operator.drive})

    grid_map = load_map(arguments.map) if arguments.map else world.map
    serve_robot(invocation, grid_map, source, extend)


def _world(named: str) -> World:
    robot = parsed_source(named)
    if not isinstance(robot, Simulated):
        problem = f"{named!r} is no simulation: name sim:WORLD or sim:MAP.yaml"
        raise SettingsError(key="bridge.source", problem=problem)
    return simulated_world(robot)


class _Operator:
    """Carries out what a person wants of the robot; a kidnapping once, however often asked."""

    def __init__(self, source: SimulatedSource, sender: str) -> None:
        self._source, self._sender = source, sender
        self._last_id = ""

    def kidnap(self, asked: Asked) -> None:
        """Lift the robot elsewhere.

        Raises:
            MalformedMessageError: for the bridge's loop to count; the query is answered.
        """
        command = _decoded(asked, Kidnap)
        if command.command_id != self._last_id:
            self._last_id = command.command_id
            x, y, heading = self._source.kidnap(command.map_from_robot)
            _log.info("the robot was lifted to (%.2f, %.2f) m, %.2f rad", x, y, heading)
        asked.answer(CommandDone(sender=self._sender))

    def drive(self, asked: Asked) -> None:
        """Drive by hand.

        Raises:
            MalformedMessageError: as above.
        """
        command = _decoded(asked, Drive)
        self._source.drive(command.speed_m_s, command.turn_rate_rad_s, by_hand=command.by_hand)
        asked.answer(CommandDone(sender=self._sender))


def _decoded(asked: Asked, expected: type[M]) -> M:
    """What is asked; one that cannot be read is refused."""
    try:
        return decode(asked.payload, expected)
    except MalformedMessageError as error:
        asked.refuse(str(error))
        raise
