"""A relay: this process at one end, at the other a router that writes down what it hears."""

import asyncio
import os
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, closing
from pathlib import Path

import pytest

from soak_test.cables import Relay, set_cables

QUIET_S, WITHIN_S = 0.2, 20.0


class Ends:
    """Of one link: streams at the process's end and at the router's."""

    def __init__(self, folder: Path) -> None:
        self.router, self.listen = folder / "router", folder / "cables"
        self.control = folder / "control"
        self.links: asyncio.Queue[tuple[asyncio.StreamReader, asyncio.StreamWriter]]
        self.links = asyncio.Queue()
        self.writers: list[asyncio.StreamWriter] = []

    @asynccontextmanager
    async def joined(self) -> AsyncIterator[None]:
        async def on_link(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            self.writers.append(writer)
            await self.links.put((reader, writer))

        router = await asyncio.start_unix_server(on_link, self.router)
        with closing(router), closing(self):
            async with Relay(self.router).serving(self.listen, self.control):
                self.heard, self.said = await self.call()
                self.router_heard, self.router_said = await self.links.get()
                await self.both_ways()
                yield

    async def call(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        reader, writer = await asyncio.open_unix_connection(self.listen)
        self.writers.append(writer)
        return reader, writer

    def close(self) -> None:
        for writer in self.writers:
            writer.close()

    def cables(self, *, to_router: bool, from_router: bool) -> None:
        set_cables(self.control, [os.getpid()], to_router=to_router, from_router=from_router)

    async def both_ways(self) -> None:
        self.said.write(b"a")
        assert await self.router_heard.readexactly(1) == b"a"
        self.router_said.write(b"b")
        assert await self.heard.readexactly(1) == b"b"


def run(folder: Path, scenario: Callable[[Ends], Awaitable[None]]) -> None:
    async def whole() -> None:
        ends = Ends(folder)
        async with ends.joined():
            await scenario(ends)

    asyncio.run(asyncio.wait_for(whole(), WITHIN_S))


async def is_quiet(reader: asyncio.StreamReader) -> bool:
    """Whether nothing comes, and no end either."""
    try:
        await asyncio.wait_for(reader.read(1), QUIET_S)
    except TimeoutError:
        return True
    return False


async def is_cut(ends: Ends, *, to_router: bool) -> None:
    """Until what is said in a direction does not arrive; the relay is told by another way."""
    said = ends.said if to_router else ends.router_said
    heard = ends.router_heard if to_router else ends.heard
    while True:
        said.write(b"?")
        if await is_quiet(heard):
            return


@pytest.mark.parametrize("to_router", [True, False])
def test_what_is_said_over_a_cut_cable_arrives_when_it_is_whole_again(
    tmp_path: Path, *, to_router: bool
) -> None:
    async def scenario(ends: Ends) -> None:
        ends.cables(to_router=not to_router, from_router=to_router)
        await is_cut(ends, to_router=to_router)
        other, heard = (
            (ends.router_said, ends.heard) if to_router else (ends.said, ends.router_heard)
        )
        other.write(b"!")
        assert await heard.readexactly(1) == b"!", "the other direction is whole"
        ends.cables(to_router=True, from_router=True)
        held = ends.router_heard if to_router else ends.heard
        assert await held.readexactly(1) == b"?"
        await ends.both_ways()

    run(tmp_path, scenario)


def test_nobody_is_told_over_a_cut_cable_that_a_link_has_ended(tmp_path: Path) -> None:
    async def scenario(ends: Ends) -> None:
        ends.cables(to_router=False, from_router=False)
        await is_cut(ends, to_router=True)
        ends.said.close()
        assert await is_quiet(ends.router_heard)
        ends.cables(to_router=True, from_router=True)
        assert await ends.router_heard.read() == b"?"

    run(tmp_path, scenario)


def test_who_calls_over_a_cut_cable_is_heard_when_it_is_whole_again(tmp_path: Path) -> None:
    async def scenario(ends: Ends) -> None:
        ends.cables(to_router=False, from_router=True)
        await is_cut(ends, to_router=True)
        heard, said = await ends.call()
        said.write(b"x")
        assert await is_quiet(heard)
        assert ends.links.empty()
        ends.cables(to_router=True, from_router=True)
        router_heard, _ = await ends.links.get()
        assert await router_heard.readexactly(1) == b"x"

    run(tmp_path, scenario)


def test_without_a_router_a_link_ends(tmp_path: Path) -> None:
    async def scenario(ends: Ends) -> None:
        ends.router.unlink()
        heard, _ = await ends.call()
        assert await heard.read() == b""

    run(tmp_path, scenario)
