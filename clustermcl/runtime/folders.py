"""The folders in which processes keep files across restarts."""

import logging
from pathlib import Path
from urllib.parse import quote

from clustermcl.filter.kernels.folders import Kind, remarks, user_folder
from clustermcl.runtime.settings import Settings

_log = logging.getLogger(__name__)


def kept_folder(kind: Kind, named: str = "") -> Path:
    """Return the folder that a setting names; empty: the user's, see `user_folder`."""
    try:
        return Path(named).expanduser() if named else user_folder(kind)
    except RuntimeError as error:  # a service without a home
        remarks[f"{named} is not used: {error}"] = None
        return user_folder(kind)
    finally:
        log_remarks()


def log_remarks() -> None:
    """Log why folders are not used; each reason once."""
    for remark in list(remarks):
        _log.warning("%s", remark)
        del remarks[remark]


def state_folder(named: str) -> Path | None:
    """Return the folder that `coordinator.state_folder` names; ``off``: None, nothing is kept."""
    return None if named == "off" else kept_folder("state", named)


def recording_folder(settings: Settings) -> Path | None:
    """Return the folder of the robot's flight recording; None: nothing is recorded."""
    folder = settings.recorder.folder
    if folder in ("", "off"):
        return None
    return kept_folder("state", folder) / quote(settings.robot.name, safe="")
