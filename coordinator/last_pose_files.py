"""The last pose on disk: it survives a power cut.

A file is written beside its name, brought to the disk, and renamed: whoever reads finds the old
one or the new one, whole. It carries a checksum of its own, for disks err; one that is broken is
named in the log and left where it is until the next pose replaces it.
"""

import hashlib
import logging
import os
import tempfile
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

import msgspec

from coordinator.pose.last_pose import LastPose

MAX_FILE_BYTES = 16 * 1024
FORMAT = 1
LEFT_AFTER_S = 60.0
"""Writing a pose takes milliseconds: a part of a file that is older was left behind."""
_PART = ".part"

_log = logging.getLogger(__name__)


class _File(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    format: int
    sha256: str
    """Of the pose, as JSON without spaces."""
    last_pose: LastPose


def default_state_folder() -> Path:
    """The user's folder for state, by the XDG rule."""
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "clustermcl"


def file_of(folder: Path, robot: str, map_digest: str) -> Path:
    """Where a robot's last pose in a map is kept."""
    return folder / f"last-pose-{quote(robot, safe='')}-{map_digest[:16]}.json"


def write(folder: Path, robot: str, pose: LastPose) -> None:
    """Keep a pose, in place of the one before.

    Raises:
        OSError: the folder cannot be written, or the disk is full; the file before is as it was.
    """
    folder.mkdir(parents=True, exist_ok=True)
    target = file_of(folder, robot, pose.map_digest)
    kept = _File(format=FORMAT, sha256=_checksum(pose), last_pose=pose)
    number, part = tempfile.mkstemp(dir=folder, prefix=target.stem, suffix=_PART)
    try:
        with os.fdopen(number, "wb") as file:
            file.write(msgspec.json.format(msgspec.json.encode(kept), indent=2) + b"\n")
            file.flush()
            os.fsync(file.fileno())
        Path(part).replace(target)
    except OSError:
        Path(part).unlink(missing_ok=True)
        raise
    _sync_folder(folder)


def remove_leftovers(folder: Path, robot: str, now_s: float) -> None:
    """Remove parts of files that a process left when it was killed while it wrote.

    Args:
        folder: where last poses are kept.
        robot: whose.
        now_s: time of the wall clock [s]; a part that is younger than `LEFT_AFTER_S` may be
            another coordinator's, at work.
    """
    for part in folder.glob(f"last-pose-{quote(robot, safe='')}-*{_PART}"):
        with suppress(OSError):  # gone already, or a folder that cannot be written
            if now_s - part.stat().st_mtime > LEFT_AFTER_S:
                part.unlink()


def read_all(folder: Path, robot: str) -> dict[str, LastPose]:
    """The poses kept of a robot, by the digest of their map; broken files are named in the log."""
    poses = {}
    for path in sorted(folder.glob(f"last-pose-{quote(robot, safe='')}-*.json")):
        try:
            pose = _read(path)
        except (OSError, ValueError) as error:
            _log.warning("%s is no last pose and is ignored: %s", path, error)
            continue
        if path == file_of(folder, robot, pose.map_digest):
            poses[pose.map_digest] = pose
    return poses


def _read(path: Path) -> LastPose:
    with path.open("rb") as file:
        data = file.read(MAX_FILE_BYTES + 1)
    if len(data) > MAX_FILE_BYTES:
        raise ValueError(f"larger than {MAX_FILE_BYTES} bytes")
    kept = msgspec.json.decode(data, type=_File)  # its errors are ValueErrors
    if kept.format != FORMAT:
        raise ValueError(f"format {kept.format}, expected {FORMAT}")
    if kept.sha256 != _checksum(kept.last_pose):
        raise ValueError("its checksum is wrong")
    if problem := kept.last_pose.problem():
        raise ValueError(problem)
    return kept.last_pose


def _checksum(pose: LastPose) -> str:
    return hashlib.sha256(msgspec.json.encode(pose)).hexdigest()


def _sync_folder(folder: Path) -> None:
    """Bring the new name to the disk too."""
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
