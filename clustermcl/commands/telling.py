"""The commands that tell a running system something."""

import math
from typing import Annotated

import typer

from clustermcl.commands.options import Assignments, SettingsFile
from process_runtime.settings_file import load_settings


def set_pose(
    x_m: Annotated[float, typer.Argument(metavar="X", help="In the map [m].")],
    y_m: Annotated[float, typer.Argument(metavar="Y", help="In the map [m].")],
    heading_rad: Annotated[float, typer.Argument(metavar="HEADING", help="In the map [rad].")],
    position_sigma_m: Annotated[
        float, typer.Option(help="Standard deviation of x and of y [m].")
    ] = 0.5,
    heading_sigma_rad: Annotated[
        float, typer.Option(help="Standard deviation of the heading [rad].")
    ] = 0.26,
    covariance: Annotated[
        tuple[float, float, float, float, float, float] | None,
        typer.Option(
            metavar="XX XY XH YY YH HH",
            help="Covariance instead, H being the heading [m2, m rad, rad2].",
        ),
    ] = None,
    stamp_ns: Annotated[
        int | None,
        typer.Option(help="It was there at this time of its clock, and has driven on since [ns]."),
    ] = None,
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Say where the robot is."""
    numbers = (x_m, y_m, heading_rad, position_sigma_m, heading_sigma_rad)
    if not all(map(math.isfinite, numbers)) or min(position_sigma_m, heading_sigma_rad) <= 0.0:
        raise typer.BadParameter("a pose is finite numbers, a standard deviation is positive")
    from clustermcl.questions import set_pose as tell  # noqa: PLC0415 - see the package

    try:
        tell(
            load_settings(settings_file, assignments or ()),
            (x_m, y_m, heading_rad),
            position_sigma_m=position_sigma_m,
            heading_sigma_rad=heading_sigma_rad,
            covariance=_symmetric(*covariance) if covariance else None,
            stamp_ns=stamp_ns,
        )
    except ValueError as problem:
        raise typer.BadParameter(str(problem)) from None


def _symmetric(
    xx: float, xy: float, xh: float, yy: float, yh: float, hh: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    return (xx, xy, xh, xy, yy, yh, xh, yh, hh)


def relocalize(
    near: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="X Y RADIUS", help="Search in this circle only [m]."),
    ] = None,
    region: Annotated[
        str, typer.Option(metavar="NAME", help="Search in this one of search.regions only.")
    ] = "",
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Forget all places and search everywhere, near a place, or in a region."""
    if near is not None and not (all(map(math.isfinite, near)) and near[2] > 0.0):
        raise typer.BadParameter("a circle is two finite numbers and a positive radius")
    from clustermcl.questions import relocalize as tell  # noqa: PLC0415 - see the package

    tell(load_settings(settings_file, assignments or ()), near, region)


def update(settings_file: SettingsFile = None, assignments: Assignments = None) -> None:
    """Make a step of the next scan, also if the robot stands still."""
    from clustermcl.questions import update as tell  # noqa: PLC0415 - see the package

    tell(load_settings(settings_file, assignments or ()))


def kidnap(settings_file: SettingsFile = None, assignments: Assignments = None) -> None:
    """Lift the simulated robot to somewhere far away."""
    from clustermcl.questions import kidnap as tell  # noqa: PLC0415 - see the package

    tell(load_settings(settings_file, assignments or ()))
