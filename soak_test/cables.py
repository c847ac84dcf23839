"""A relay between processes and their router: cables that can be cut, also in one direction.

``python -I -m soak_test.cables --listen SOCKET --router SOCKET --control SOCKET``. What comes to
a cut is held back, as TCP sends it again and again: nobody is told, also not of a link's end, and
when the cable is whole, all goes on where it was. Who calls over a cut cable is not heard.
"""

import argparse
import asyncio
import socket
import struct
from collections import defaultdict
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager, closing, suppress
from pathlib import Path

import msgspec

from process_runtime.main import Invocation, process_main
from process_runtime.stop import StopFlag

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
    asyncio.run(_relay(given.listen, given.router, given.control, invocation.stop))


async def _relay(listen: Path, router: Path, control: Path, stop: StopFlag) -> None:
    async with Relay(router).serving(listen, control):
        while not stop.is_set():
            await asyncio.sleep(_LOOK_EVERY_S)


class _Cable:
    """Of one process; an event that is set lets through."""

    def __init__(self) -> None:
        self.to_router, self.from_router = asyncio.Event(), asyncio.Event()
        self.set(to_router=True, from_router=True)

    def set(self, *, to_router: bool, from_router: bool) -> None:
        for event, whole in ((self.to_router, to_router), (self.from_router, from_router)):
            (event.set if whole else event.clear)()


class Relay(asyncio.DatagramProtocol):
    """All cables, by the process at their end.

    Args:
        router: the socket it listens at.
    """

    def __init__(self, router: Path) -> None:
        self._router = router
        self._cables: defaultdict[int, _Cable] = defaultdict(_Cable)
        self._links: set[asyncio.Task[None]] = set()

    @asynccontextmanager
    async def serving(self, listen: Path, control: Path) -> AsyncIterator[None]:
        """Let processes connect, and be told what to cut."""
        told, _ = await asyncio.get_running_loop().create_datagram_endpoint(
            lambda: self, local_addr=str(control), family=socket.AF_UNIX
        )
        with closing(told), closing(await asyncio.start_unix_server(self._on_link, listen)):
            yield

    def datagram_received(self, data: bytes, _address: object) -> None:
        """Be told."""
        cables = msgspec.json.decode(data, type=Cables)
        for pid in cables.pids:
            self._cables[pid].set(to_router=cables.to_router, from_router=cables.from_router)

    def _on_link(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Begin a task: asyncio's own complains of those that are cancelled when all ends."""
        link = asyncio.create_task(self._join(reader, writer))
        self._links.add(link)
        link.add_done_callback(self._links.discard)

    async def _join(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Carry what a process and the router say to each other, until both have closed."""
        cable = self._cables[_pid_of(writer)]
        with closing(writer), suppress(OSError):  # without a router the link ends
            await cable.to_router.wait()
            from_router, to_router = await asyncio.open_unix_connection(self._router)
            await asyncio.gather(
                _carry(reader, to_router, cable.to_router),
                _carry(from_router, writer, cable.from_router),
            )


async def _carry(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, whole: asyncio.Event
) -> None:
    with closing(writer):
        with suppress(ConnectionError):
            while data := await reader.read(_PIECE_BYTES):
                await whole.wait()
                writer.write(data)
                await writer.drain()
        await whole.wait()


def _pid_of(writer: asyncio.StreamWriter) -> int:
    """The process at the other end of a Unix socket."""
    link: socket.socket = writer.get_extra_info("socket")
    credentials = link.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER_CREDENTIALS.size)
    pid: int = _PEER_CREDENTIALS.unpack(credentials)[0]
    return pid


if __name__ == "__main__":
    main()
