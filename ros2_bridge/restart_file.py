"""The state of a killed bridge, from which a new one continues if it starts soon enough.

Nav2's lifecycle manager waits 4 s for a heartbeat, then shuts down and restarts all its nodes. A
bridge that starts earlier continues in the same state with the same bond. A later one starts
unconfigured, as the manager then expects.
"""

import logging
import os
import tempfile
import time
from pathlib import Path
from urllib.parse import quote

import msgspec

from process_runtime.settings import Settings
from process_runtime.state_folder import state_folder
from ros2_bridge.bond import TIMEOUT_S
from ros2_bridge.lifecycle import State

_EVERY_S = 0.5
_MAX_BYTES = 1024

_log = logging.getLogger(__name__)


class Doing(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The state of a bridge."""

    state: State
    bond: str
    """The bond's instance id; the manager treats a new id as another node."""
    held: int | None
    """The cluster that is published as the pose."""


class RestartFile:
    """Exists while the bridge runs and after it was killed; the ``with`` block removes it.

    Args:
        path: of the file; None: no file.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._kept: Doing | None = None
        self._again_s = 0.0

    def __enter__(self) -> "RestartFile":
        return self

    def __exit__(self, *_: object) -> None:
        if self._path is not None:
            self._path.unlink(missing_ok=True)

    def read(self) -> Doing | None:
        """The state of a bridge that was killed just now; None: there is none."""
        path = self._path
        try:
            if path is None or not path.is_file():
                return None
            with path.open("rb") as file:
                about, content = os.fstat(file.fileno()), file.read(_MAX_BYTES)
            doing = msgspec.json.decode(content, type=Doing)
        except (OSError, msgspec.DecodeError) as error:
            _log.warning("%s is not used: %s", path, error)
            return None
        return doing if 0.0 <= time.time() - about.st_mtime < TIMEOUT_S else None

    def keep(self, doing: Doing, now_s: float) -> None:
        """Write a changed state; update the file's time twice a second."""
        if self._path is None or (doing == self._kept and now_s < self._again_s):
            return
        try:
            if doing == self._kept:
                os.utime(self._path)
            else:
                _replace(self._path, msgspec.json.encode(doing))
        except OSError as error:
            _log.warning("a killed bridge will start unconfigured: %s", error)
            self._path = None
        self._kept, self._again_s = doing, now_s + _EVERY_S


def restart_file(settings: Settings, node: str) -> RestartFile:
    """The file of a node, in the coordinator's folder for its state.

    Args:
        settings: of all processes.
        node: its full name.
    """
    folder = state_folder(settings.coordinator.state_folder)
    if folder is None:
        return RestartFile(None)
    name = quote(f"{settings.robot.name}-{settings.ros2.domain_id}{node}", safe="")
    return RestartFile(folder / f"ros2-{name}.json")


def _replace(path: Path, content: bytes) -> None:
    """Replace the content atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    number, part = tempfile.mkstemp(dir=path.parent, prefix=path.stem, suffix=".part")
    with os.fdopen(number, "wb") as file:
        file.write(content)
    Path(part).replace(path)
