"""An unused port of this machine."""

import socket


def free_port() -> int:
    """A port that was free a moment ago; the system does not hand it out again so soon."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
