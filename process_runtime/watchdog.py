"""Signs of life of a process, by systemd's protocol (``sd_notify(3)``).

A process sends datagrams to the socket in NOTIFY_SOCKET, to systemd or to our supervisor, which
restarts a process that stops sending. Without the variable nothing is sent.
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
    """Return the function that a process's loop calls in each turn.

    Its first call reports READY, so make it after a slow start. Later calls are passed on
    at the rate that the supervisor requires.

    Args:
        environment: the variables are removed, because child processes must not use them.
    """
    address = environment.pop(SOCKET_VARIABLE, "")
    interval_s = int(environment.pop(INTERVAL_VARIABLE, "0")) / 1e6 or float("inf")
    if not address or environment.pop(_PID_VARIABLE, str(os.getpid())) != str(os.getpid()):
        return _nothing
    sender = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    sender.setblocking(False)  # losing a sign is better than blocking the loop
    if address.startswith("@"):  # abstract, without a file
        address = f"\0{address[1:]}"
    return _Signs(sender, address, interval_s / _SIGNS_AN_INTERVAL).give


def _nothing() -> None:
    """Do nothing: there is no supervisor."""


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
        with suppress(OSError):  # no listener, or its buffer is full
            self._sender.sendto(self._words, self._address)
            self._words = b"WATCHDOG=1"
            self._due_s = now_s + self._every_s


class HangDetector:
    """Detects a process that stopped giving signs of life; times are `time.monotonic` [s].

    A paused container stops both the process and its observer. So after a gap between two calls
    of `hangs`, the silence is measured from the second one.

    Args:
        hung_after_s: longest silence after the first sign of life [s].
    """

    def __init__(self, hung_after_s: float) -> None:
        self._hung_after_s = hung_after_s
        self._sign_s = self._looked_s = float("inf")
        self._since_s = 0.0

    def on_sign(self, at_s: float) -> None:
        self._sign_s = at_s

    def hangs(self, now_s: float) -> bool:
        gap_s, self._looked_s = now_s - self._looked_s, now_s
        if gap_s > self._hung_after_s / _SIGNS_AN_INTERVAL:
            self._since_s = now_s
        return now_s - max(self._sign_s, self._since_s) > self._hung_after_s


class Listener:
    """Receives the signs of life of one child; Linux only.

    Args:
        hung_after_s: longest silence of the child after its first sign of life [s].
    """

    def __init__(self, hung_after_s: float) -> None:
        self._hung_after_s = hung_after_s
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind("")  # an abstract address chosen by the kernel, without a file
        self._detector = HangDetector(hung_after_s)

    def variables(self) -> dict[str, str]:
        """Return the variables for the child's environment."""
        return {
            SOCKET_VARIABLE: "@" + self._socket.getsockname()[1:].decode(),
            INTERVAL_VARIABLE: str(int(self._hung_after_s * 1e6)),
        }

    def is_hung(self, now_s: float) -> bool:
        with suppress(BlockingIOError):
            while self._socket.recv(64):
                self._detector.on_sign(now_s)
        return self._detector.hangs(now_s)

    def close(self) -> None:
        self._socket.close()
