"""Who runs this program, as the sender of its commands."""

import os
import platform
import pwd
import sys
from functools import cache
from pathlib import Path

from clustermcl.protocol.message import MAX_ID_CHARACTERS


@cache
def caller(program: str = "") -> str:
    """Return such as ``clustermcl of anna@laptop``; by default of the program that was started."""
    started = Path(sys.argv[0] if sys.argv else "")
    started = started.parent if started.name == "__main__.py" else started
    program = program or started.name or "python"
    try:
        user = pwd.getpwuid(os.getuid()).pw_name
    except KeyError:  # a container's user may have no name
        user = f"user {os.getuid()}"
    return f"{program} of {user}@{platform.node()}"[:MAX_ID_CHARACTERS]
