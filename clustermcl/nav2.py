"""Settings based on a robot's `nav2_params.yaml`."""

from collections.abc import Sequence
from pathlib import Path

from process_runtime.settings import Settings
from process_runtime.settings_file import load_settings
from ros2_bridge.nav2_params import read_nav2_params


def settings_with_nav2(
    nav2_params: Path | None, settings_file: Path | None, assignments: Sequence[str]
) -> tuple[Settings, list[str]]:
    """Load settings: assignments override the file, the file overrides nav2's parameters.

    Args:
        nav2_params: of the robot; None: defaults.
        settings_file: TOML, or None.
        assignments: ``section.key=value``.

    Returns:
        The settings, and a line for each parameter that has no or another effect here.

    Raises:
        InputFileError: a file is unreadable or malformed.
        SettingsError: a value is out of range.
    """
    if nav2_params is None:
        return load_settings(settings_file, assignments), []
    read = read_nav2_params(nav2_params)
    settings = load_settings(
        settings_file, assignments, beneath=read.values, beneath_from=str(nav2_params)
    )
    return settings, list(read.notes)
