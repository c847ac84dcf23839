"""One picture of now: what a running system shows, looked at for a moment."""

import time
from contextlib import closing
from typing import Any

from live_view.live_loop import LiveLoop
from process_runtime.settings import Settings
from process_runtime.stop import StopFlag
from protocol.errors import UnreachableError
from protocol.steps import MapMessage

STANDS_AFTER_S = 2.0
"""A robot that has published no step with its scan for so long stands: its places are asked for."""
MAP_WITHIN_S = 30.0


def looked_at(settings: Settings, stop: StopFlag) -> tuple[dict[str, Any], MapMessage]:
    """All frames of one robot's page, and its map.

    Args:
        settings: the router's endpoint and the robot's name.
        stop: looked at while waiting.

    Raises:
        UnreachableError: there is no router, or nobody who localizes the robot.
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
                and _has_all(frames)
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
                raise _nobody(settings, loop.picture.link, waited_s)


def _has_all(frames: dict[str, Any]) -> bool:
    return all(topic in frames for topic in ("map", "step", "pose", "status", "events"))


def _nobody(settings: Settings, link: str, waited_s: float) -> UnreachableError:
    router, robot = settings.zenoh.router, settings.robot.name
    problem = {
        "no router": f"no router at {router}: start one with 'clustermcl up', or set zenoh.router",
        "no system": f"nobody localizes robot {robot!r} at {router}: set robot.name",
    }.get(link, f"robot {robot!r} at {router} has no map or no place yet: try again")
    return UnreachableError(who="system", endpoint=router, waited_s=waited_s, problem=problem)
