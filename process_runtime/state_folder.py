"""Where processes keep state that outlives them."""

import os
from pathlib import Path


def default_state_folder() -> Path:
    """The user's folder for state, by the XDG rule.

    Raises:
        RuntimeError: the account has no home.
    """
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "clustermcl"
