"""A relay between processes and their router: cables that can be cut, also in one direction.

``python -I -m soak_test.cables --listen SOCKET --router SOCKET --control SOCKET``. What comes to
a cut is held back, as TCP sends it again and again: nobody is told, also not of a link's end, and
when the cable is whole, all goes on where it was. Who calls over a cut cable is not heard.
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

from process_runtime.main import Invocation, process_main

_PIECE_BYTES = 65536
_LOOK_EVERY_S = 0.05
_PEER_CREDENTIALS = struct.Struct("3i")


class Cables(msgspec.Struct, frozen=True, kw_only=True):
    """What the cables of some processes shall let through. To the control socket, as JSON."""

    pids: tuple[int, ...]
    to_router: bool
    from_router: bool


def set_cables(control: Path, pids: Iterable[int], *, to_router: bool, from_router: bool) -> None:
    """Cut the cables of these processes, or mend them.

    Args:
        control: the relay's socket.
        pids: of the processes; also links that they open later are meant.
        to_router: whether what they send gets through.
        from_router: whether what they are sent does.
    """
    cables = Cables(pids=tuple(pids), to_router=to_router, from_router=from_router)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.sendto(msgspec.json.encode(cables), str(control))


def main() -> None:
    """Run the relay."""
    process_main("cables", _run, describe="Cables to be cut.", add_arguments=_add_arguments)


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--listen", type=Path, required=True, help="where processes connect")
    parser.add_argument("--router", type=Path, required=True, help="where the router listens")
    parser.add_argument("--control", type=Path, required=True, help="where it is told what to cut")


def _run(invocation: Invocation) -> None:
    given = invocation.arguments
    relay = Relay(given.listen, given.router, given.control)
    while not invocation.stop.is_set():
        relay.be_told(_LOOK_EVERY_S)


class _Cable:
    """Of one process; an event that is set lets through."""

    def __init__(self) -> None:
        self.to_router, self.from_router = Event(), Event()
        self.set(to_router=True, from_router=True)

    def set(self, *, to_router: bool, from_router: bool) -> None:
        for event, whole in ((self.to_router, to_router), (self.from_router, from_router)):
            (event.set if whole else event.clear)()


class Relay:
    """All cables, by the process at their end; two threads a link, that wait nearly always.

    Args:
        listen: where processes connect from now on.
        router: where the router listens.
        control: where it is told what to cut.
    """

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

    def be_told(self, wait_s: float) -> None:
        """Wait so long for somebody to say what is to be cut or mended."""
        self._control.settimeout(wait_s)
        with suppress(TimeoutError):
            cables = msgspec.json.decode(self._control.recv(_PIECE_BYTES), type=Cables)
            for pid in cables.pids:
                self._cables[pid].set(to_router=cables.to_router, from_router=cables.from_router)

    def close(self) -> None:
        """Let nobody connect any more."""
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
        """Carry what a process and the router say to each other, until both have closed."""
        cable = self._cables[_pid_of(link)]
        cable.to_router.wait()
        with link, socket.socket(socket.AF_UNIX) as router, suppress(OSError):
            router.connect(str(self._router))
            back = _begin(_carry, router, link, cable.from_router)
            _carry(link, router, cable.to_router)
            back.join()


def _begin(work: Callable[..., None], *arguments: object) -> Thread:
    """A thread that does not keep the process from its end."""
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
    """The process at the other end of a Unix socket."""
    credentials = link.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER_CREDENTIALS.size)
    pid: int = _PEER_CREDENTIALS.unpack(credentials)[0]
    return pid


if __name__ == "__main__":
    main()
