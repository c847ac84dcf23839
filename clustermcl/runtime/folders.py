"""The folders in which processes keep files across restarts, and claims of them."""

import fcntl
import logging
import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
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


@contextmanager
def claimed(lock: Path) -> Iterator[bool]:
    """Claim a folder, or what a lock file stands for; yield whether it was free.

    The kernel ends the claim with this process. An `OSError`: the file cannot be opened.
    """
    flags = os.O_RDONLY if lock.is_dir() else os.O_RDWR | os.O_CREAT
    number = os.open(lock, flags | os.O_NOFOLLOW, 0o600)
    try:
        try:
            fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True
    finally:
        os.close(number)


@contextmanager
def owned(folder: Path, settings: Settings) -> Iterator[bool]:
    """Claim a robot's files in a folder; yield False if another robot of this name has them.

    A coordinator that takes over from a frozen one finds its claim, and continues with the files.
    """
    owner, other = f"{socket.gethostname()} {settings.zenoh.router}", ""
    lock = folder / f"{quote(settings.robot.name, safe='')}.lock"
    with ExitStack() as stack:
        with suppress(OSError):  # logged when the files are written
            folder.mkdir(parents=True, exist_ok=True)
            if stack.enter_context(claimed(lock)):
                lock.write_text(owner, "utf-8")
            with lock.open(encoding="utf-8") as file:
                other = file.read(1_000)
        is_own = other in ("", owner)
        if not is_own:
            _log.warning(
                "%s is in use by another robot %r (%s): nothing is kept there for this one; set "
                "robot.name, or another folder",
                *(folder, settings.robot.name, other),
            )
        yield is_own
