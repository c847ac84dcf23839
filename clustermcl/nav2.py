"""Settings that stand on a robot's own `nav2_params.yaml`."""

from collections.abc import Sequence
from pathlib import Path

from process_runtime.settings import Settings
from process_runtime.settings_file import load_settings
from ros2_bridge.nav2_params import read_nav2_params


def settings_with_nav2(
    nav2_params: Path | None, settings_file: Path | None, assignments: Sequence[str]
) -> tuple[Settings, list[str]]:
    """The settings: what nav2 says of AMCL, over it the file, over it the assignments.

    Args:
        nav2_params: of the robot; None: defaults.
        settings_file: TOML, or None.
        assignments: ``section.key=value``.

    Returns:
        the settings, and a line for each thing that is not as nav2's file says.

    Raises:
        InputFileError: a file cannot be read, or is not what it should be.
        SettingsError: a value is out of its range.
    """
    if nav2_params is None:
        return load_settings(settings_file, assignments), []
    read = read_nav2_params(nav2_params)
    settings = load_settings(
        settings_file, assignments, beneath=read.values, beneath_from=str(nav2_params)
    )
    return settings, list(read.notes)
