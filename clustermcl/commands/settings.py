"""`clustermcl settings`: print the settings, or convert those of nav2."""

from pathlib import Path
from typing import Annotated, Any

import typer

from clustermcl.commands.options import Assignments, SettingsFile, flag, option
from clustermcl.ros2.nav2_params import read_nav2_params
from clustermcl.runtime.settings_file import load_settings
from clustermcl.runtime.settings_table import EVERYDAY, TABLE, settings_as_toml


def settings(
    from_nav2: Annotated[Path | None, option("Convert a nav2_params.yaml.", "FILE")] = None,
    show_all: Annotated[bool, flag("--all", "Also constants of filter and service.")] = False,
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Print the settings with default, unit and meaning, as TOML.

    The output is a valid file for --settings.
    """
    values: dict[str, Any] = {}
    if from_nav2 is not None:
        values, notes = read_nav2_params(from_nav2)
        for line in notes:
            typer.echo(f"# {line}")
    chosen = load_settings(
        settings_file, assignments or (), beneath=values, beneath_from=str(from_nav2)
    )
    if not show_all:
        count = f"{len(EVERYDAY)} of {len(TABLE)} settings"
        typer.echo(f"# {count}; clustermcl settings --all prints all.\n")
    typer.echo(settings_as_toml(chosen, None if show_all else EVERYDAY), nl=False)
