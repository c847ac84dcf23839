"""The commands that change a running system."""

import math
from typing import Annotated

import typer

from clustermcl.commands import options as opt
from clustermcl.commands.as_text import pose_text
from clustermcl.protocol.errors import SettingsError
from clustermcl.runtime.logs import is_quiet
from clustermcl.runtime.settings import Settings


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
    sigmas = (position_sigma_m, heading_sigma_deg)
    if not all(map(math.isfinite, (x_m, y_m, heading_deg, *sigmas))) or min(sigmas) <= 0.0:
        raise typer.BadParameter("a pose needs finite numbers and positive standard deviations")
    pose = (x_m, y_m, math.remainder(math.radians(heading_deg), math.tau))
    try:
        with opt.connected(settings) as client:
            client.set_pose(
                pose,
                position_sigma_m=position_sigma_m,
                heading_sigma_rad=math.radians(heading_sigma_deg),
                floor=floor,
            )
    except ValueError as problem:
        raise typer.BadParameter(str(problem)) from None
    _report(settings, f"was set to {pose_text(pose, floor)}")


@opt.client_command
def relocalize(
    settings: Settings,
    near: Annotated[
        tuple[float, float, float] | None,
        opt.option("Search only in this circle [m].", "X Y RADIUS"),
    ] = None,
    region: Annotated[str, opt.option("Search only in this region.", "NAME")] = "",
    floor: opt.Floor = "",
) -> None:
    """Drop all places, and search everywhere or in part of the map."""
    if near is not None and region:
        raise SettingsError("--near and --region exclude each other: give one")
    if near is not None and not (all(map(math.isfinite, near)) and near[2] > 0.0):
        raise typer.BadParameter("a circle needs two finite numbers and a positive radius")
    with opt.connected(settings) as client:
        client.relocalize(near, region, floor)
    where = f"in region {region}" if region else "everywhere"
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


@opt.client_command
def kidnap(settings: Settings) -> None:
    """Kidnap the simulated robot: move it far away."""
    with opt.connected(settings) as client:
        client.kidnap()
    _report(settings, "was moved far away")


def _report(settings: Settings, what: str) -> None:
    if not is_quiet():
        opt.print_answer([f"robot {settings.robot.name!r} {what}"])
