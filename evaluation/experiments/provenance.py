"""Where figures come from: enough to make them again."""

import importlib.metadata
import os
import platform
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from process_runtime.settings import Settings
from process_runtime.settings_table import TABLE

_GIT_TIMEOUT_S = 5.0
Value = bool | int | float | str


class Provenance(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What was run, of which state of the code, where and when."""

    command: str
    version: str
    commit: str | None
    """Of the repository that the code lies in, with `-dirty` if its files differ from that
    commit; None: the code lies in no repository."""
    started: str
    """Date and time, UTC."""
    machine: str
    python: str
    numpy: str
    numba: str
    jobs: int
    settings: dict[str, Value]
    """Settings that differ from the defaults, by name."""


def provenance(command: str, settings: Settings, jobs: int) -> Provenance:
    """Look all this up."""
    cores = os.cpu_count()
    return Provenance(
        command=command,
        version=importlib.metadata.version("clustermcl"),
        commit=_commit(Path(__file__).parent),
        started=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        machine=f"{platform.system()} {platform.machine()}, {cores} cores",
        python=platform.python_version(),
        numpy=importlib.metadata.version("numpy"),
        numba=importlib.metadata.version("numba"),
        jobs=jobs,
        settings=dict(changed_settings(settings)),
    )


def changed_settings(settings: Settings) -> Mapping[str, Value]:
    """Settings that differ from the defaults, by dotted name."""
    changed: dict[str, Value] = {}
    for name, info in TABLE.items():
        section, _, key = name.rpartition(".")
        value = getattr(getattr(settings, section) if section else settings, key)
        if value != info.default:
            changed[name] = value
    return changed


def _commit(folder: Path) -> str | None:
    commit = _git(folder, "rev-parse", "HEAD")
    if commit is None:
        return None
    changed = _git(folder, "status", "--porcelain", "--untracked-files=no")
    return f"{commit}-dirty" if changed else commit


def _git(folder: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments],
            capture_output=True,
            text=True,
            timeout=_GIT_TIMEOUT_S,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
