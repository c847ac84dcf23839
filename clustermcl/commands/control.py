"""The commands that change a running system."""

import math
from typing import Annotated

import typer

from clustermcl.commands.as_text import pose_text
from clustermcl.commands.options import (
    Floor,
    argument,
    client_command,
    connected,
    option,
    print_answer,
)
from clustermcl.protocol.errors import SettingsError
from clustermcl.runtime.logs import is_quiet
from clustermcl.runtime.settings import Settings


@client_command
def set_pose(
    settings: Settings,
    x_m: Annotated[float, argument("X", "In the map [m].")],
    y_m: Annotated[float, argument("Y", "In the map [m].")],
    heading_deg: Annotated[float, argument("HEADING", "In the map, counter-clockwise [deg].")],
    position_sigma_m: Annotated[float, option("Standard deviation of x and of y [m].", "M")] = 0.5,
    heading_sigma_deg: Annotated[
        float, option("Standard deviation of HEADING [deg].", "DEG")
    ] = 15.0,
    floor: Floor = "",
) -> None:
    """Set the robot's pose; the heading is in degrees."""
    sigmas = (position_sigma_m, heading_sigma_deg)
    if not all(map(math.isfinite, (x_m, y_m, heading_deg, *sigmas))) or min(sigmas) <= 0.0:
        raise typer.BadParameter("a pose needs finite numbers and positive standard deviations")
    pose = (x_m, y_m, math.remainder(math.radians(heading_deg), math.tau))
    try:
        with connected(settings) as client:
            client.set_pose(
                pose,
                position_sigma_m=position_sigma_m,
                heading_sigma_rad=math.radians(heading_sigma_deg),
                floor=floor,
            )
    except ValueError as problem:
        raise typer.BadParameter(str(problem)) from None
    _report(settings, f"was set to {pose_text(pose, floor)}")


@client_command
def relocalize(
    settings: Settings,
    near: Annotated[
        tuple[float, float, float] | None, option("Search only in this circle [m].", "X Y RADIUS")
    ] = None,
    region: Annotated[str, option("Search only in this region of search.regions.", "NAME")] = "",
    floor: Floor = "",
) -> None:
    """Drop all places, and search everywhere or in part of the map."""
    if near is not None and region:
        raise SettingsError("--near and --region exclude each other: give one")
    if near is not None and not (all(map(math.isfinite, near)) and near[2] > 0.0):
        raise typer.BadParameter("a circle needs two finite numbers and a positive radius")
    with connected(settings) as client:
        client.relocalize(near, region, floor)
    where = f"in region {region}" if region else "everywhere"
    if near is not None:
        where = f"within {near[2]:g} m of x {near[0]:g} m  y {near[1]:g} m"
    on = f" on floor {floor}" if floor else ""
    _report(settings, f"drops all places; the search runs {where}{on}")


@client_command
def update(settings: Settings) -> None:
    """Use the next scan for a step, even if the robot stands still."""
    with connected(settings) as client:
        client.update()
    _report(settings, "uses its next scan for a step")


@client_command
def kidnap(settings: Settings) -> None:
    """Kidnap the simulated robot: move it far away."""
    with connected(settings) as client:
        client.kidnap()
    _report(settings, "was moved far away")


def _report(settings: Settings, what: str) -> None:
    if not is_quiet():
        print_answer([f"robot {settings.robot.name!r} {what}"])
