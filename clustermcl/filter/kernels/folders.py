"""The folders of files that are kept between runs, and whether others may have changed them.

Compiled code is loaded from there, and arrays whose numbers kernels use as indices.
"""

import grp
import os
import pwd
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Literal, TypeAlias

Kind: TypeAlias = Literal["kernels", "maps", "state"]

remarks: dict[str, None] = {}
"""Reasons why folders are not used, which the process logs."""

_AT_HOME = {"XDG_CACHE_HOME": ".cache", "XDG_STATE_HOME": ".local/state"}


def user_folder(kind: Kind) -> Path:
    """Return the user's folder for one kind of files, by the XDG rule; it may not exist yet.

    A relative folder is ignored, as the standard demands. For an account without a home, or whose
    home cannot be written, it is a folder among the temporary files, which others cannot enter.
    """
    variable = "XDG_STATE_HOME" if kind == "state" else "XDG_CACHE_HOME"
    name = "clustermcl" if kind == "state" else f"clustermcl/{kind}"
    home = os.path.expanduser(f"~/{_AT_HOME[variable]}")  # noqa: PTH111 - Path's raises without one
    for origin, base in ((variable, os.environ.get(variable)), ("the account's home", home)):
        if base and is_usable(Path(base, name), origin):
            return Path(base, name)
    folder = _temporary_folder() / kind
    remarks[f"{kind}: kept in {folder} until the machine restarts; set {variable}"] = None
    return folder


def is_usable(path: Path, origin: str) -> bool:
    """Return whether a path is absolute, and exists or can be created; else add a remark."""
    known = next((one for one in (path, *path.parents) if os.access(one, os.F_OK)), path)
    if path.is_absolute() and (known == path or os.access(known, os.W_OK)):
        return True
    problem = "cannot be written" if path.is_absolute() else "is not absolute"
    remarks[f"{path} of {origin} is not used: it {problem}"] = None
    return False


@cache
def _temporary_folder() -> Path:
    try:
        folder = Path(tempfile.gettempdir(), f"clustermcl-{os.geteuid()}")
        with suppress(FileExistsError):
            folder.mkdir(0o700)
        return Path(tempfile.mkdtemp(prefix="clustermcl-")) if why_untrusted(folder) else folder
    except OSError:  # there is none; whoever uses this one reports it
        return Path("/nonexistent")


def why_untrusted(path: Path) -> str:
    """Return why others may have changed a file or folder; empty: they cannot, or it is missing.

    Others are all accounts but this one, root, and the owner of the program.
    """
    try:
        status = path.stat()
    except OSError:
        return ""
    if status.st_uid not in (0, os.geteuid(), Path(__file__).stat().st_uid):
        return f"{path} belongs to another account ({status.st_uid})"
    if status.st_mode & 0o002 or (status.st_mode & 0o020 and not _is_private_group(status)):
        return f"other accounts may write {path}; run chmod go-w on it"
    return ""


def _is_private_group(status: os.stat_result) -> bool:
    """Whether a group has one member: the owner, whose name or number it has."""
    try:
        names = pwd.getpwuid(status.st_uid).pw_name, grp.getgrgid(status.st_gid).gr_name
    except KeyError:
        names = "", "unknown"
    return status.st_uid == status.st_gid or names[0] == names[1]
