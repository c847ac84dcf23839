"""The file with the key that a robot's coordinators share; `deploy/certificates.sh` makes it."""

import os
import stat
from pathlib import Path

from protocol.errors import SettingsError

LEAST_BYTES, MOST_BYTES = 32, 4_096
"""Of the file; the script writes 64 characters, 256 bits."""


def read_key(name: str) -> bytes | None:
    """The key in a file; None where no file is named.

    Raises:
        SettingsError: it cannot be read, is no key, or every user of the machine may read it.
    """
    if not name:
        return None
    try:
        with Path(name).expanduser().open("rb") as file:
            is_open = os.fstat(file.fileno()).st_mode & stat.S_IRWXO
            key = file.read(MOST_BYTES + 1).strip()
    except (OSError, RuntimeError) as error:  # a `~` without a home
        raise _refused(name, getattr(error, "strerror", None) or str(error)) from error
    if is_open:
        raise _refused(name, "others may read or write it; run chmod o= on it")
    if not LEAST_BYTES <= len(key) <= MOST_BYTES:
        raise _refused(name, f"a key has {LEAST_BYTES} to {MOST_BYTES} bytes, this has {len(key)}")
    return key


def _refused(name: str, problem: str) -> SettingsError:
    key = "coordinator.key_file"
    return SettingsError(key=key, problem=f"{key} = {name!r}: {problem}")
