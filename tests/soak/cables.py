"""A relay between processes and their router that cuts links, in both directions or in one.

``python -I -m tests.soak.cables --listen SOCKET --router SOCKET --control SOCKET``. A cut link
holds data back, as TCP does while it retransmits: neither side learns of the cut or of a closed
connection, and a mended link delivers everything. A new connection over a cut link has to wait.
"""

import argparse
import socket
import struct
from collections import defaultdict
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from threading import Event, Thread

import msgspec

from clustermcl.runtime.main import Invocation, process_main

_PIECE_BYTES = 65536
_LOOK_EVERY_S = 0.05
_PEER_CREDENTIALS = struct.Struct("3i")


class Cables(msgspec.Struct, frozen=True, kw_only=True):
    """Which directions are open for some processes; sent to the control socket as JSON."""

    pids: tuple[int, ...]
    to_router: bool
    from_router: bool


def set_cables(control: Path, pids: Iterable[int], *, to_router: bool, from_router: bool) -> None:
    cables = Cables(pids=tuple(pids), to_router=to_router, from_router=from_router)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.sendto(msgspec.json.encode(cables), str(control))


def main() -> None:
    process_main(
        "cables", _run, describe="Relay whose links can be cut.", add_arguments=_add_arguments
    )


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--listen", type=Path, required=True, help="socket for processes")
    parser.add_argument("--router", type=Path, required=True, help="socket of the router")
    parser.add_argument("--control", type=Path, required=True, help="socket for commands")


def _run(invocation: Invocation) -> None:
    given = invocation.arguments
    relay = Relay(given.listen, given.router, given.control)
    while not invocation.stop.is_set():
        relay.receive_command(_LOOK_EVERY_S)


class _Cable:
    """The links of one process; a set event means that the direction is open."""

    def __init__(self) -> None:
        self.to_router, self.from_router = Event(), Event()
        self.set(to_router=True, from_router=True)

    def set(self, *, to_router: bool, from_router: bool) -> None:
        for event, whole in ((self.to_router, to_router), (self.from_router, from_router)):
            (event.set if whole else event.clear)()


class Relay:
    """All links by process id, with two threads per link."""

    def __init__(self, listen: Path, router: Path, control: Path) -> None:
        self._router = router
        self._cables: defaultdict[int, _Cable] = defaultdict(_Cable)
        self._control = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._control.bind(str(control))
        self._server = socket.socket(socket.AF_UNIX)
        self._server.bind(str(listen))
        self._server.listen()
        self._closed = False
        _begin(self._accept)

    def receive_command(self, wait_s: float) -> None:
        self._control.settimeout(wait_s)
        with suppress(TimeoutError):
            cables = msgspec.json.decode(self._control.recv(_PIECE_BYTES), type=Cables)
            for pid in cables.pids:
                self._cables[pid].set(to_router=cables.to_router, from_router=cables.from_router)

    def close(self) -> None:
        self._closed = True
        self._server.shutdown(socket.SHUT_RDWR)
        self._control.close()

    def _accept(self) -> None:
        with self._server:
            while True:
                try:
                    link, _ = self._server.accept()
                except OSError:
                    if self._closed:
                        return
                    raise
                _begin(self._join, link)

    def _join(self, link: socket.socket) -> None:
        """Relay both directions until both sides have closed."""
        cable = self._cables[_pid_of(link)]
        cable.to_router.wait()
        with link, socket.socket(socket.AF_UNIX) as router, suppress(OSError):
            router.connect(str(self._router))
            back = _begin(_carry, router, link, cable.from_router)
            _carry(link, router, cable.to_router)
            back.join()


def _begin(work: Callable[..., None], *arguments: object) -> Thread:
    thread = Thread(target=work, args=arguments, daemon=True)
    thread.start()
    return thread


def _carry(source: socket.socket, target: socket.socket, whole: Event) -> None:
    with suppress(OSError):
        while data := source.recv(_PIECE_BYTES):
            whole.wait()
            target.sendall(data)
    whole.wait()
    with suppress(OSError):  # it has ended already
        target.shutdown(socket.SHUT_RDWR)


def _pid_of(link: socket.socket) -> int:
    credentials = link.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER_CREDENTIALS.size)
    pid: int = _PEER_CREDENTIALS.unpack(credentials)[0]
    return pid


if __name__ == "__main__":
    main()
