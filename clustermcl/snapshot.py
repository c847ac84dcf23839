"""`clustermcl snapshot`: save what the page shows as a picture or an HTML file."""

import time
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from live_view.drawing import drawn_picture
from live_view.live_loop import LiveLoop
from live_view.saved_page import saved_page
from process_runtime.output_files import check_output_file, write_output_file
from process_runtime.settings import Settings
from process_runtime.stop import StopFlag, stop_on_signals
from protocol.errors import SettingsError, UnreachableError
from protocol.steps import MapMessage

KINDS = (".png", ".html")
STANDS_AFTER_S = 2.0
"""Time without a step after which the robot counts as standing still, so places are queried."""
MAP_WITHIN_S = 30.0


def save_snapshot(file: Path, settings: Settings) -> None:
    """Save what the page of a running system shows.

    Args:
        file: path that ends in ``.png``, or in ``.html`` for a page that needs no server.
        settings: the router's endpoint and the robot's name.

    Raises:
        SettingsError: the path has another suffix.
        UnreachableError: no system of this robot is running, or it has no map or place yet.
        OutputError: the file cannot be written.
    """
    if file.suffix.lower() not in KINDS:
        problem = f"{file}: a snapshot is a .png or a .html file"
        raise SettingsError(key="FILE", problem=problem)
    check_output_file(file)
    frames, grid_map = frames_and_map(settings, stop_on_signals())
    if file.suffix.lower() == ".png":
        drawn_picture(grid_map, frames["step"]).save(file)
    else:
        now = f"{datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC"
        write_output_file(file, saved_page(frames, grid_map, now))


def frames_and_map(settings: Settings, stop: StopFlag) -> tuple[dict[str, Any], MapMessage]:
    """Return the frames of one robot's page by topic, and the map.

    Raises:
        UnreachableError: no system of this robot is running, or it has no map or place yet.
        StoppedError: `stop` was set.
    """
    loop = LiveLoop(settings, {"commands": False}, stop)
    begun_s = time.monotonic()
    has_asked = False
    with closing(loop.node):
        while True:
            frames, waited_s = loop.picture.everything(), time.monotonic() - begun_s
            if (
                loop.map is not None
                and {"map", "step", "pose", "status", "events"} <= frames.keys()
                and (frames["step"]["scan"] or waited_s > STANDS_AFTER_S)
            ):
                return frames, loop.map
            stop.check()
            loop.turn()
            if waited_s > STANDS_AFTER_S and not has_asked and "status" in frames:
                has_asked = True
                loop.ask_for_places()
            limit_s = MAP_WITHIN_S if "status" in frames else settings.zenoh.connect_timeout_s
            if waited_s > limit_s:
                raise _unreachable(settings, loop.picture.link, waited_s)


def _unreachable(settings: Settings, link: str, waited_s: float) -> UnreachableError:
    router, robot = settings.zenoh.router, settings.robot.name
    problem = {
        "no router": f"no router at {router}: start one with 'clustermcl up', or set zenoh.router",
        "no system": f"no coordinator for robot {robot!r} at {router}: set robot.name",
    }.get(link, f"robot {robot!r} at {router} has no map or no place yet: try again")
    return UnreachableError(peer="system", endpoint=router, waited_s=waited_s, problem=problem)
