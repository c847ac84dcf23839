"""The sensor bridge process: a robot's readings, or a recording, to numbered steps."""

import argparse
import logging
from collections.abc import Callable
from functools import partial
from typing import assert_never

import zenoh

from grid_maps.grid_map import GridMap
from process_runtime.main import Invocation, process_main
from process_runtime.settings import BridgeSettings
from process_runtime.sources import NO_MAP, Live, Recorded, Simulated, is_published, parsed_source
from protocol import keys
from protocol.errors import AlreadyRunningError, SettingsError
from recordings.map_file import load_map, map_file_of
from sensor_bridge.loop import BridgeLoop
from sensor_bridge.recorded import RecordedSource
from sensor_bridge.source import Extension, Source
from zenoh_link.session import open_session
from zenoh_link.stale_session import is_there
from zenoh_link.wire import is_alive

_log = logging.getLogger(__name__)


def main() -> None:
    """Run the bridge."""
    process_main(
        "sensor_bridge",
        run_bridge,
        describe="Sensor bridge of Cluster-MCL: synchronises, gates and numbers scans.",
        add_arguments=_add_arguments,
    )


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--map", metavar="FILE", help="map file (default: bridge.map)")
    parser.add_argument(
        "--source", metavar="SOURCE", help="recording, or 'zenoh' (default: bridge.source)"
    )


def run_bridge(invocation: Invocation) -> None:
    """Bridge until told to stop.

    Raises:
        SettingsError: no map is named, or the source is a simulation.
        MapFileError: the map cannot be used.
        RecordingError: the recording cannot be used.
    """
    settings, arguments = invocation.settings.bridge, invocation.arguments
    source = arguments.source or settings.source
    map_file = map_file_of(arguments.map or settings.map, source)
    if is_published(map_file, source, ros2=invocation.settings.ros2.enabled):
        _log.info("waits for a map on %s", keys.MAP_READING)
        serve_robot(invocation, None, None)
        return
    if not map_file:
        raise SettingsError(key="bridge.map", problem=NO_MAP)
    grid_map = load_map(map_file)
    serve_robot(invocation, grid_map, source_of(source, settings))


def source_of(named: str, settings: BridgeSettings) -> Source | None:
    """What a bridge takes readings from; None: a robot publishes them.

    Raises:
        SettingsError: the source is a simulation.
        RecordingError: the recording cannot be used.
    """
    match parsed_source(named):
        case Live():
            return None
        case Recorded(path):
            return RecordedSource(path, settings)
        case Simulated():
            raise SettingsError(
                key="bridge.source",
                problem=f"{named} is a simulation: start 'python -I -m robot_simulator' instead",
            )
        case choice:
            assert_never(choice)


def serve_robot(
    invocation: Invocation,
    grid_map: GridMap | None,
    source: Source | None,
    extend: Callable[[zenoh.Session], Extension] = lambda _session: Extension(),
) -> None:
    """Publish the steps of a source and serve the map until told to stop.

    Args:
        invocation: of the process.
        grid_map: the map to localize in; None: a robot publishes it.
        source: readings; None: a robot publishes them over Zenoh.
        extend: what the source adds to the bridge, given the open session.

    Raises:
        AlreadyRunningError: the robot has a bridge.
    """
    settings, stop = invocation.settings, invocation.stop
    sees = partial(is_there, settings.zenoh, settings.robot, stop)
    # What a robot of its own lives through, another session would break off.
    is_coordinator_there = partial(sees, keys.COORDINATOR_ALIVE) if source is None else _no
    while not stop.is_set():
        with open_session(settings.zenoh, settings.robot, stop, wait_s=None) as session:
            if is_alive(session, keys.BRIDGE_ALIVE, settings.zenoh.query_timeout_s):
                raise AlreadyRunningError(
                    what="a sensor bridge",
                    robot=settings.robot.name,
                    endpoint=settings.zenoh.router,
                    advice="stop it, or choose another robot.name",
                )
            loop = BridgeLoop(
                *(invocation.process, session, settings.bridge, grid_map, source),
                extend(session),
                is_coordinator_there,
            )
            loop.run(stop)


def _no() -> bool:
    return False
