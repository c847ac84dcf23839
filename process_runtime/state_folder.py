"""The folder in which processes keep state across restarts."""

import logging
import os
from pathlib import Path
from urllib.parse import quote

from process_runtime.settings import Settings

_log = logging.getLogger(__name__)


def default_state_folder() -> Path:
    """Return the user's folder for state, by the XDG rule.

    Raises:
        RuntimeError: the account has no home.
    """
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "clustermcl"


def state_folder(named: str) -> Path | None:
    """Return the folder that `coordinator.state_folder` names; None: no state is kept.

    Args:
        named: a folder, ``off``, or empty for the default.
    """
    if named == "off":
        return None
    try:
        return Path(named).expanduser() if named else default_state_folder()
    except RuntimeError as error:  # a service without a home
        _log.warning("the state is not kept: %s; set coordinator.state_folder", error)
        return None


def recording_folder(settings: Settings) -> Path | None:
    """Return the folder of the robot's flight recording; None: nothing is recorded."""
    folder = settings.recorder.folder
    if folder in ("", "off"):
        return None
    return Path(folder).expanduser() / quote(settings.robot.name, safe="")
