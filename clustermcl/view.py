"""`clustermcl view`: serve the page that shows the clusters, until Ctrl-C."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import assert_never

from coordinator.recorder.replay import recorded_bridge, replayed
from grid_maps.map_message import to_message
from live_view.admission import parsed_address
from live_view.process import serve_page
from live_view.recorded_bag import bag_run
from live_view.recorded_run import RecordedRun, flight_run, serve_recording
from live_view.serving import PageOptions
from process_runtime.settings import BridgeSettings, Settings
from process_runtime.sources import Live, Recorded, Simulated, parsed_source
from process_runtime.stop import stop_on_signals
from protocol.errors import ClusterMclError, MapFileError, RecordingError
from protocol.steps import MapMessage
from recordings.bag_file import BagFile, is_bag
from recordings.map_file import load_map, map_file_of
from robot_simulator.source import simulated_world


@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """Options of the command."""

    listen: str
    allow_commands: bool = False
    open_browser: bool = False
    certificate: Path | None = None
    private_key: Path | None = None
    robots: Sequence[str] = ()
    """Names of robots; empty: the one in the settings."""
    recording: Path | None = None
    """A flight recorder's folder, or a file in it, or a bag; None: show a running system."""
    map_file: Path | None = None
    """Map of the recording; None: the one named by its settings."""


def run_view(settings: Settings, options: ViewOptions) -> None:
    """Serve the page; it waits for the system, also after a loss.

    Raises:
        SettingsError: the address, a certificate or a name is invalid.
        InputFileError: there is no recording, or it cannot be read.
        MapFileError: the map of the recording cannot be read.
    """
    page = PageOptions(
        address=parsed_address(options.listen),
        allow_commands=options.allow_commands,
        open_browser=options.open_browser,
        certificate=options.certificate,
        private_key=options.private_key,
    )
    if options.recording is None:
        serve_page(settings, stop_on_signals(), page, say_link, robots=options.robots)
        return
    with _opened_run(options.recording, options.map_file) as run:
        serve_recording(run, stop_on_signals(), page, say_link)


@contextmanager
def _opened_run(path: Path, map_file: Path | None) -> Iterator[RecordedRun]:
    """Open a bag or a flight recording."""
    if is_bag(path):
        with BagFile(path, RecordingError) as bag:
            run = bag_run(bag, path)
            yield RecordedRun(run, _map_of_bag(path, map_file), {"robot": path.stem})
        return
    folder = path.parent if path.is_file() else path
    drawn = _map_of(folder, map_file)
    happenings = replayed(folder, version("clustermcl"), drawn.digest if drawn else None)
    yield RecordedRun(flight_run(happenings), drawn, {"robot": folder.resolve().name})


def _map_of_bag(path: Path, named: Path | None) -> MapMessage | None:
    """The named map, or the one in the bag; None: there is none."""
    try:
        return to_message(load_map(named or path), "recording")
    except MapFileError as error:
        if named:
            raise
        _say(f"no map is drawn, name it by --map: {error}")
        return None


def _map_of(folder: Path, named: Path | None) -> MapMessage | None:
    """The map of a recording; None: its file no longer exists or has changed."""
    if named is not None:
        return to_message(load_map(named), "recording")
    bridge = recorded_bridge(folder, version("clustermcl"))
    try:
        return map_of_bridge(bridge) if bridge else None
    except ClusterMclError as error:
        _say(f"no map is drawn, name it by --map: {error}")
        return None


def map_of_bridge(bridge: BridgeSettings) -> MapMessage:
    """The map that a bridge with these settings serves.

    Raises:
        MapFileError: it is not there any more.
        UnknownWorldError: so is the world of a simulated robot.
    """
    match parsed_source(bridge.source):
        case Simulated() as robot:
            grid_map = load_map(bridge.map) if bridge.map else simulated_world(robot).map
        case Recorded(path):
            grid_map = load_map(map_file_of(bridge.map, path))
        case Live():
            grid_map = load_map(bridge.map)
        case choice:
            assert_never(choice)
    return to_message(grid_map, "recording")


def say_link(link: str) -> None:
    """Print the link of the page."""
    _say(f"look at {link}")


def _say(text: str) -> None:
    sys.stderr.write(f"clustermcl: {text}\n")
    sys.stderr.flush()
