"""Signs of life: a process gives them, and whoever started it restarts one that gives none.

The way is systemd's (``sd_notify(3)``): datagrams to the socket that NOTIFY_SOCKET names. Our own
supervisor listens in the same way. Nobody is told anything where there is no such variable.
"""

import os
import socket
import time
from collections.abc import Callable, MutableMapping
from contextlib import suppress

SOCKET_VARIABLE, INTERVAL_VARIABLE = "NOTIFY_SOCKET", "WATCHDOG_USEC"
_PID_VARIABLE = "WATCHDOG_PID"
_SIGNS_AN_INTERVAL = 4


def sign_of_life(environment: MutableMapping[str, str] = os.environ) -> Callable[[], None]:
    """What a process's loop calls in each turn, at best where it looks whether to stop.

    The first call says that the process is ready, so it belongs after what takes long. Of the
    later ones as many are passed on as systemd asks for.

    Args:
        environment: is cleared of the variables: they are not meant for our own children.
    """
    address = environment.pop(SOCKET_VARIABLE, "")
    interval_s = int(environment.pop(INTERVAL_VARIABLE, "0")) / 1e6 or float("inf")
    if not address or environment.pop(_PID_VARIABLE, str(os.getpid())) != str(os.getpid()):
        return _nothing
    sender = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    sender.setblocking(False)  # rather a sign too few than a loop that waits
    if address.startswith("@"):  # abstract, without a file
        address = f"\0{address[1:]}"
    return _Signs(sender, address, interval_s / _SIGNS_AN_INTERVAL).give


def _nothing() -> None:
    """Nobody listens."""


class _Signs:
    def __init__(self, sender: socket.socket, address: str, every_s: float) -> None:
        self._sender, self._address, self._every_s = sender, address, every_s
        self._due_s = 0.0
        self._words = b"READY=1\nWATCHDOG=1"

    def __del__(self) -> None:
        self._sender.close()

    def give(self) -> None:
        now_s = time.monotonic()
        if now_s < self._due_s:
            return
        with suppress(OSError):  # nobody is there, or has no time
            self._sender.sendto(self._words, self._address)
            self._words = b"WATCHDOG=1"
            self._due_s = now_s + self._every_s


class HangDetector:
    """Told of a process's signs of life, and often asked; times are `time.monotonic` [s].

    Who asks may have been stopped for a while, and the process with it, as in a container that
    was paused. So the silence counts anew after a gap between two questions.

    Args:
        hung_after_s: how long the process may be silent, once it has given a sign [s].
    """

    def __init__(self, hung_after_s: float) -> None:
        self._hung_after_s = hung_after_s
        self._heard_s = self._asked_s = float("inf")
        self._since_s = 0.0

    def heard(self, at_s: float) -> None:
        """The process gave a sign of life."""
        self._heard_s = at_s

    def hangs(self, now_s: float) -> bool:
        """Whether it has been silent for too long."""
        gap_s, self._asked_s = now_s - self._asked_s, now_s
        if gap_s > self._hung_after_s / _SIGNS_AN_INTERVAL:
            self._since_s = now_s
        return now_s - max(self._heard_s, self._since_s) > self._hung_after_s


class Listener:
    """Hears the signs of life of one child at a time; Linux only.

    Args:
        hung_after_s: how long a child may be silent that has given a sign before [s].
    """

    def __init__(self, hung_after_s: float) -> None:
        self._hung_after_s = hung_after_s
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind("")  # an abstract address that the kernel chooses: no file is left
        self._detector = HangDetector(hung_after_s)

    def variables(self) -> dict[str, str]:
        """For the child's environment."""
        return {
            SOCKET_VARIABLE: "@" + self._socket.getsockname()[1:].decode(),
            INTERVAL_VARIABLE: str(int(self._hung_after_s * 1e6)),
        }

    def is_hung(self, now_s: float) -> bool:
        """Whether the child has been silent for too long; `now_s` is `time.monotonic` [s]."""
        with suppress(BlockingIOError):
            while self._socket.recv(64):
                self._detector.heard(now_s)
        return self._detector.hangs(now_s)

    def close(self) -> None:
        """Listen no more."""
        self._socket.close()
