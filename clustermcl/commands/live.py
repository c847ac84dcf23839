"""The commands that query or control a running system."""

import math
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Annotated

import msgspec

from clustermcl.commands import as_text as text
from clustermcl.commands import options as opt
from clustermcl.commands.as_json import json_object
from clustermcl.protocol.errors import SettingsError
from clustermcl.protocol.job_events import probability_of
from clustermcl.robot_commands import RobotCommands
from clustermcl.runtime.logs import is_quiet
from clustermcl.runtime.settings import Settings

EXIT_NO_POSE = 4


@opt.client_command
def pose(settings: Settings, as_json: opt.AsJson = False) -> None:
    """Print the robot's pose, its uncertainty, and reasons to doubt it.

    Exit code 4 if the pose is not safe to drive by: stale, dead reckoning, lost, or unknown.
    """
    with opt.connected(settings) as client:
        answer = client.pose()
    opt.print_answer(json_object(answer) if as_json else text.pose_lines(answer))
    if answer.pose is None or answer.freshness != "fresh" or answer.state == "lost":
        sys.exit(EXIT_NO_POSE)


@opt.client_command
def hypotheses(
    settings: Settings,
    above: opt.Above = 0.0,
    why: Annotated[bool, opt.flag("--why", "Also why each probability changed.")] = False,
    as_json: opt.AsJson = False,
) -> None:
    """Print all places where the robot may be, with probabilities."""
    with opt.connected(settings) as client:
        answer = client.hypotheses()
    kept = tuple(place for place in answer.hypotheses if place.probability >= above)
    answer = msgspec.structs.replace(answer, hypotheses=kept)
    opt.print_answer(json_object(answer) if as_json else text.hypotheses_lines(answer, why=why))


@opt.client_command
def advise(settings: Settings, as_json: opt.AsJson = False) -> None:
    """Print where to drive so that scans distinguish the possible places."""
    with opt.connected(settings) as client:
        answer = client.advice()
    opt.print_answer(json_object(answer) if as_json else text.advice_lines(answer))


@opt.client_command
def events(settings: Settings, above: opt.Above = 0.0, as_json: opt.AsJson = False) -> None:
    """Print what began and ended and why, commands, and faults of sensors."""
    with opt.connected(settings) as client:
        answer = client.events()
    kept = tuple(each for each in answer.events if probability_of(each.event) >= above)
    answer = msgspec.structs.replace(answer, events=kept)
    opt.print_answer(json_object(answer) if as_json else text.event_lines(answer.events))


@opt.client_command
def status(settings: Settings, as_json: opt.AsJson = False) -> None:
    """Print steps, workers, and counts of dropped data."""
    with opt.connected(settings) as client:
        answer = client.status()
    opt.print_answer(json_object(answer) if as_json else text.status_lines(answer))


@opt.client_command
def watch(settings: Settings, as_json: opt.AsJson = False) -> None:
    """Print each new belief, until Ctrl-C."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with suppress(KeyboardInterrupt), opt.connected(settings) as client:
        for belief in client.beliefs():
            opt.print_answer(json_object(belief) if as_json else [text.belief_line(belief)])


@opt.client_command
def set_pose(
    settings: Settings,
    x_m: Annotated[float, opt.argument("X", "In the map [m].")],
    y_m: Annotated[float, opt.argument("Y", "In the map [m].")],
    heading_deg: Annotated[float, opt.argument("HEADING", "In the map, counter-clockwise [deg].")],
    position_sigma_m: Annotated[float, opt.option("Standard deviation of x, of y [m].", "M")] = 0.5,
    heading_sigma_deg: Annotated[float, opt.option("That of HEADING [deg].", "DEG")] = 15.0,
    floor: opt.Floor = "",
) -> None:
    """Set the robot's pose; the heading is in degrees."""
    named = (x_m, y_m, math.radians((heading_deg + 180.0) % 360.0 - 180.0))
    _command(
        settings,
        lambda robot: robot.set_pose(
            named,
            position_sigma_m=position_sigma_m,
            heading_sigma_rad=math.radians(heading_sigma_deg),
            floor=floor,
        ),
    )
    _report(settings, f"was set to {text.pose_text(named, floor)}")


@opt.client_command
def relocalize(
    settings: Settings,
    near: Annotated[
        tuple[float, float, float] | None,
        opt.option("Search only in this circle [m].", "X Y RADIUS"),
    ] = None,
    floor: opt.Floor = "",
) -> None:
    """Drop all places, and search everywhere or in part of the map."""
    _command(settings, lambda robot: robot.relocalize(near, floor))
    where = "everywhere"
    if near is not None:
        where = f"within {near[2]:g} m of x {near[0]:g} m  y {near[1]:g} m"
    on = f" on floor {floor}" if floor else ""
    _report(settings, f"drops all places; the search runs {where}{on}")


@opt.client_command
def update(settings: Settings) -> None:
    """Use the next scan for a step, even if the robot stands still."""
    with opt.connected(settings) as client:
        client.update()
    _report(settings, "uses its next scan for a step")


def _report(settings: Settings, what: str) -> None:
    if not is_quiet():
        opt.print_answer([f"robot {settings.robot.name!r} {what}"])


def _command(settings: Settings, command: Callable[[RobotCommands], None]) -> None:
    """Give a command; refuse wrong numbers before the system is looked for."""
    try:
        command(RobotCommands())
    except ValueError as problem:
        raise SettingsError(str(problem)) from None
    with opt.connected(settings) as client:
        command(client)
