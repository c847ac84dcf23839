"""The commands that change a running system."""

import math
from typing import Annotated

import typer

from clustermcl.as_text import pose_text
from clustermcl.commands.options import client_command, connected, print_answer
from process_runtime.logs import is_quiet
from process_runtime.settings import Settings
from protocol.errors import SettingsError

_SIGMA_M, _SIGMA_DEG = 0.5, 15.0


@client_command
def set_pose(
    settings: Settings,
    x_m: Annotated[float, typer.Argument(metavar="X", help="In the map [m].")],
    y_m: Annotated[float, typer.Argument(metavar="Y", help="In the map [m].")],
    heading_deg: Annotated[
        float, typer.Argument(metavar="HEADING", help="In the map, counter-clockwise [deg].")
    ],
    position_sigma_m: Annotated[
        float | None,
        typer.Option(metavar="M", help=f"Standard deviation of x and of y [m]; {_SIGMA_M}."),
    ] = None,
    heading_sigma_deg: Annotated[
        float | None,
        typer.Option(metavar="DEG", help=f"Standard deviation of HEADING [deg]; {_SIGMA_DEG}."),
    ] = None,
    covariance: Annotated[
        tuple[float, float, float, float, float, float] | None,
        typer.Option(
            metavar="XX XY XH YY YH HH",
            help="Covariance instead, H being the heading [m2, m deg, deg2].",
        ),
    ] = None,
    stamp_ns: Annotated[
        int | None,
        typer.Option(help="Time of the pose by the robot's clock; later motion is added [ns]."),
    ] = None,
) -> None:
    """Set the robot's pose; the heading is in degrees."""
    if covariance is not None and (position_sigma_m, heading_sigma_deg) != (None, None):
        problem = "--covariance replaces both sigmas: leave them out"
        raise SettingsError(key="--covariance", problem=problem)
    position_m = _SIGMA_M if position_sigma_m is None else position_sigma_m
    heading_sigma = _SIGMA_DEG if heading_sigma_deg is None else heading_sigma_deg
    numbers = (x_m, y_m, heading_deg, position_m, heading_sigma)
    if not all(map(math.isfinite, numbers)) or min(position_m, heading_sigma) <= 0.0:
        raise typer.BadParameter("a pose needs finite numbers and positive standard deviations")
    pose = (x_m, y_m, math.radians(heading_deg))
    try:
        with connected(settings) as client:
            client.set_pose(
                pose,
                position_sigma_m=position_m,
                heading_sigma_rad=math.radians(heading_sigma),
                covariance=_symmetric(*covariance) if covariance else None,
                stamp_ns=stamp_ns,
            )
    except ValueError as problem:
        raise typer.BadParameter(str(problem)) from None
    _report(settings, f"was set to {pose_text(pose)}")


def _symmetric(
    xx: float, xy: float, xh: float, yy: float, yh: float, hh: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Return a covariance row by row, with degrees converted to radians."""
    rad = math.pi / 180.0
    xh, yh, hh = xh * rad, yh * rad, hh * rad * rad
    return (xx, xy, xh, xy, yy, yh, xh, yh, hh)


@client_command
def relocalize(
    settings: Settings,
    near: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="X Y RADIUS", help="Search only in this circle [m]."),
    ] = None,
    region: Annotated[
        str, typer.Option(metavar="NAME", help="Search only in this region of search.regions.")
    ] = "",
) -> None:
    """Drop all places, and search everywhere or in a region."""
    if near is not None and region:
        problem = "--near and --region exclude each other: give one"
        raise SettingsError(key="--near", problem=problem)
    if near is not None and not (all(map(math.isfinite, near)) and near[2] > 0.0):
        raise typer.BadParameter("a circle needs two finite numbers and a positive radius")
    with connected(settings) as client:
        client.relocalize(near, region)
    where = f"in region {region}" if region else "everywhere"
    if near is not None:
        where = f"within {near[2]:g} m of x {near[0]:g} m  y {near[1]:g} m"
    _report(settings, f"has no places any more; the search runs {where}")


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
