"""A relay between processes and their router, whose end breaks all their links."""

import argparse
import asyncio
import os
from contextlib import suppress

from clustermcl.runtime.main import Invocation, process_main

_PIECE_BYTES = 65536
_LOOK_EVERY_S = 0.05


async def _relay(invocation: Invocation) -> None:
    given = invocation.arguments

    async def join(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            far_reader, far_writer = await asyncio.open_unix_connection(given.router)
            await asyncio.gather(_carry(reader, far_writer), _carry(far_reader, writer))
            far_writer.close()
        writer.close()

    async with await asyncio.start_unix_server(join, given.listen):
        while not invocation.stop.is_set():
            await asyncio.sleep(_LOOK_EVERY_S)
        os._exit(0)  # asyncio would cancel the links that are still open, and log it


async def _carry(source: asyncio.StreamReader, target: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while data := await source.read(_PIECE_BYTES):
            target.write(data)
            await target.drain()
    with suppress(OSError):  # it has ended already
        target.write_eof()


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--listen", required=True, help="socket for processes")
    parser.add_argument("--router", required=True, help="socket of the router")


if __name__ == "__main__":
    process_main(
        "relay",
        lambda invocation: asyncio.run(_relay(invocation)),
        describe="Relay to the router.",
        add_arguments=_add_arguments,
    )
