"""A relay between processes and their router that cuts links, in both directions or in one.

``python -I -m tests.soak.cables --listen SOCKET --router SOCKET --control SOCKET``. A cut link
holds data back, as TCP does while it retransmits: neither side learns of the cut or of a closed
connection, and a mended link delivers everything. A new connection over a cut link has to wait.
"""

import argparse
import asyncio
import os
import socket
import struct
from collections import defaultdict
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

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


class _Cable:
    """The links of one process; a set event means that the direction is open."""

    def __init__(self) -> None:
        self.to_router, self.from_router = asyncio.Event(), asyncio.Event()
        self.set(to_router=True, from_router=True)

    def set(self, *, to_router: bool, from_router: bool) -> None:
        for event, whole in ((self.to_router, to_router), (self.from_router, from_router)):
            (event.set if whole else event.clear)()


async def _relay(invocation: Invocation) -> None:
    given, cables = invocation.arguments, defaultdict[int, _Cable](_Cable)

    async def join(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Relay both directions until both sides have closed."""
        peer = writer.get_extra_info("socket")
        size = _PEER_CREDENTIALS.size
        credentials = peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size)
        cable = cables[_PEER_CREDENTIALS.unpack(credentials)[0]]
        with suppress(OSError):
            await cable.to_router.wait()
            far_reader, far_writer = await asyncio.open_unix_connection(given.router)
            await asyncio.gather(
                _carry(reader, far_writer, cable.to_router),
                _carry(far_reader, writer, cable.from_router),
            )
            far_writer.close()
        writer.close()

    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as control:
        control.bind(given.control)

        def on_command() -> None:
            command = msgspec.json.decode(control.recv(_PIECE_BYTES), type=Cables)
            for pid in command.pids:
                cables[pid].set(to_router=command.to_router, from_router=command.from_router)

        asyncio.get_running_loop().add_reader(control, on_command)
        async with await asyncio.start_unix_server(join, given.listen):
            while not invocation.stop.is_set():
                await asyncio.sleep(_LOOK_EVERY_S)
            os._exit(0)  # asyncio would cancel the links that are still open, and log it


async def _carry(
    source: asyncio.StreamReader, target: asyncio.StreamWriter, whole: asyncio.Event
) -> None:
    with suppress(OSError):
        while data := await source.read(_PIECE_BYTES):
            await whole.wait()
            target.write(data)
            await target.drain()
    await whole.wait()
    with suppress(OSError):  # it has ended already
        target.write_eof()


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--listen", required=True, help="socket for processes")
    parser.add_argument("--router", required=True, help="socket of the router")
    parser.add_argument("--control", required=True, help="socket for commands")


if __name__ == "__main__":
    process_main(
        "cables",
        lambda invocation: asyncio.run(_relay(invocation)),
        describe="Relay whose links can be cut.",
        add_arguments=_add_arguments,
    )
