"""The pages that are open on one robot: what they say, and what they are sent."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from live_view.backlog import Backlog
from live_view.commands import Command, Drawn, Question


class Browser:
    """One open page, as a handle for whoever answers it; used on the server's own thread.

    Args:
        send: told what goes to the page now; it shall not wait, few messages are under way.
    """

    def __init__(self, send: Callable[[bytes], None]) -> None:
        self._backlog = Backlog({})
        self.drives = False
        """A person drives the simulated robot on this page."""
        self._send = send

    def offer(self, frames: Mapping[str, bytes]) -> None:
        """Give it newer frames."""
        self._backlog.offer(frames)
        self._send_owed()

    def on_drawn(self, drawn: Drawn) -> None:
        """It has drawn what it was sent."""
        self._backlog.on_drawn(drawn.count, slow=drawn.slow)
        self._send_owed()

    def _send_owed(self) -> None:
        if frames := self._backlog.take():
            self._send(b"{" + b",".join(frames) + b"}")


@dataclass(frozen=True)
class Joined:
    """A page was opened: it wants everything."""

    browser: Browser


@dataclass(frozen=True)
class Commanded:
    """A person has pressed a button."""

    browser: Browser
    command: Command


@dataclass(frozen=True)
class Questioned:
    """A page wants to know something of the past."""

    browser: Browser
    question: Question


FromBrowser = Joined | Commanded | Questioned


class Room:
    """One robot's pages. `set_map`, `publish` and `tell` may be called from any thread.

    Args:
        name: the robot's; part of its link.
        on_event: told what browsers do, on the server's thread: put, and return.
    """

    def __init__(self, name: str, on_event: Callable[[FromBrowser], object]) -> None:
        self.name, self.on_event = name, on_event
        self.browsers: set[Browser] = set()
        self.map: tuple[str, bytes] = ("", b"")
        """Digest and packed cells."""
        self.loop: asyncio.AbstractEventLoop | None = None
        """The server's, once it serves."""

    def set_map(self, digest: str, zlib_cells: bytes) -> None:
        """The cells that the page fetches next, packed."""
        self.map = (digest, zlib_cells)

    def publish(self, frames: Mapping[str, Any]) -> None:
        """Send frames to every page; a slow one skips those that are replaced meanwhile."""
        if self.browsers:
            self._soon(self._offer_all, encoded(frames))

    def tell(self, browser: Browser, frames: Mapping[str, Any]) -> None:
        """Send frames to one page."""
        self._soon(browser.offer, encoded(frames))

    def _soon(
        self, act: Callable[[Mapping[str, bytes]], None], frames: Mapping[str, bytes]
    ) -> None:
        if self.loop is not None:
            self.loop.call_soon_threadsafe(act, frames)

    def _offer_all(self, frames: Mapping[str, bytes]) -> None:
        for browser in self.browsers:
            browser.offer(frames)


def encoded(frames: Mapping[str, Any]) -> dict[str, bytes]:
    """Each frame as a member of a JSON object; once for all browsers."""
    return {
        topic: b'"%s":%s' % (topic.encode(), msgspec.json.encode(frame))
        for topic, frame in frames.items()
    }
