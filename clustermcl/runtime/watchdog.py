"""Signs of life of a process, by systemd's protocol (``sd_notify(3)``).

A process sends datagrams to the socket in NOTIFY_SOCKET, to systemd or to our supervisor, which
restarts a process that stops sending. Without the variable nothing is sent. A worker also sends
its number of jobs, in a variable of its own, as the protocol allows.
"""

import os
import socket
import time
from collections.abc import MutableMapping
from contextlib import suppress

SOCKET_VARIABLE, INTERVAL_VARIABLE = "NOTIFY_SOCKET", "WATCHDOG_USEC"
_PID_VARIABLE = "WATCHDOG_PID"
_SIGNS_AN_INTERVAL = 4
_JOBS = b"X_JOBS="


class SignsOfLife:
    """Sends a process's signs of life, if it has a supervisor.

    Removes the variables from the environment, because child processes must not use them.
    """

    def __init__(self, environment: MutableMapping[str, str] = os.environ) -> None:
        address = environment.pop(SOCKET_VARIABLE, "")
        interval_s = int(environment.pop(INTERVAL_VARIABLE, "0")) / 1e6 or float("inf")
        is_for_us = environment.pop(_PID_VARIABLE, str(os.getpid())) == str(os.getpid())
        self._due_s = 0.0 if address and is_for_us else float("inf")
        self._every_s = interval_s / _SIGNS_AN_INTERVAL
        self._words, self._jobs = b"READY=1\nWATCHDOG=1", b""
        # An address that begins with @ is abstract: it has no file.
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self._sender = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._sender.setblocking(False)  # losing a sign is better than blocking the loop

    def __del__(self) -> None:
        self._sender.close()

    def give(self) -> None:
        """Send a sign of life if one is due; call this in each turn of the process's loop.

        The first call reports READY, so make it after a slow start.
        """
        now_s = time.monotonic()
        if now_s < self._due_s:
            return
        with suppress(OSError):  # no listener, or its buffer is full
            self._sender.sendto(self._words + self._jobs, self._address)
            self._words = b"WATCHDOG=1"
            self._due_s = now_s + self._every_s

    def report_jobs(self, count: int) -> None:
        """Report how many jobs the process has, at once if the number has changed."""
        jobs = b"\n%s%d" % (_JOBS, count)
        if jobs != self._jobs and self._due_s < float("inf"):
            self._jobs, self._due_s = jobs, 0.0
            self.give()


class Listener:
    """Receives the signs of life of one child, and detects its hang.

    It hangs without a sign of life for `hung_after_s` after the first one. A paused container stops
    both the process and its observer. So after a gap between two calls of `is_hung`, the silence is
    measured from the second one. Times are `time.monotonic` [s].
    """

    def __init__(self, hung_after_s: float) -> None:
        self._hung_after_s = hung_after_s
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind("")  # an abstract address chosen by the kernel, without a file
        self._sign_s = self._looked_s = float("inf")
        self._since_s = 0.0
        self.jobs: int | None = None
        """The number of jobs that the child reported last; None: it has not reported any."""

    def variables(self) -> dict[str, str]:
        return {
            SOCKET_VARIABLE: "@" + self._socket.getsockname()[1:].decode(),
            INTERVAL_VARIABLE: str(int(self._hung_after_s * 1e6)),
        }

    def is_hung(self, now_s: float) -> bool:
        with suppress(BlockingIOError):
            while words := self._socket.recv(64):
                self._sign_s = now_s
                for word in words.split(b"\n"):
                    if word.startswith(_JOBS) and word[len(_JOBS) :].isdigit():
                        self.jobs = int(word[len(_JOBS) :])
        gap_s, self._looked_s = now_s - self._looked_s, now_s
        if gap_s > self._hung_after_s / _SIGNS_AN_INTERVAL:
            self._since_s = now_s
        return now_s - max(self._sign_s, self._since_s) > self._hung_after_s

    def fileno(self) -> int:
        """Return the file from which `is_hung` reads."""
        return self._socket.fileno()

    def close(self) -> None:
        self._socket.close()
