"""The open pages of one robot: their requests, and the frames for them."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from live_view.commands import Command, Drawn, Question

MESSAGES_AHEAD = 6
"""Limit for unacknowledged messages to a fast page, which acknowledges several at once."""


class Backlog:
    """Queue of frames for a browser, which holds them back until the last ones are drawn.

    Each frame is a state, so a newer frame replaces a waiting one of its topic. A slow browser
    skips frames, and the queue holds at most one frame for each topic.

    Args:
        frames: first encoded frames to send, by topic.
    """

    def __init__(self, frames: Mapping[str, bytes]) -> None:
        self._owed = dict(frames)
        self._under_way, self._ahead = 0, MESSAGES_AHEAD

    def offer(self, frames: Mapping[str, bytes]) -> None:
        """Add newer frames."""
        self._owed.update(frames)

    def on_drawn(self, count: int, *, slow: bool) -> None:
        """Handle an acknowledgement of the browser.

        Args:
            count: number of messages drawn since the last acknowledgement.
            slow: send each message only when the last one is drawn.
        """
        self._under_way = max(self._under_way - count, 0)
        self._ahead = 1 if slow else MESSAGES_AHEAD

    def take(self) -> list[bytes]:
        """Return the frames to send now; none while the browser draws."""
        if self._under_way >= self._ahead or not self._owed:
            return []
        frames = list(self._owed.values())
        self._owed.clear()
        self._under_way += 1
        return frames


class Browser:
    """One open page; used on the server's own thread.

    Args:
        send: function that sends a message to the page without waiting.
    """

    def __init__(self, send: Callable[[bytes], None]) -> None:
        self._backlog = Backlog({})
        self.drives = False
        """Whether the simulated robot is driven manually on this page."""
        self._send = send

    def offer(self, frames: Mapping[str, bytes]) -> None:
        """Send newer frames, now or when the page has drawn the last ones."""
        self._backlog.offer(frames)
        self._send_owed()

    def on_drawn(self, drawn: Drawn) -> None:
        self._backlog.on_drawn(drawn.count, slow=drawn.slow)
        self._send_owed()

    def _send_owed(self) -> None:
        if frames := self._backlog.take():
            self._send(b"{" + b",".join(frames) + b"}")


@dataclass(frozen=True)
class Joined:
    """A page was opened, and needs all frames."""

    browser: Browser


@dataclass(frozen=True)
class Commanded:
    """A page sent a command."""

    browser: Browser
    command: Command


@dataclass(frozen=True)
class Questioned:
    """A page requested frames or rows of the past."""

    browser: Browser
    question: Question


FromBrowser = Joined | Commanded | Questioned


class Room:
    """One robot's pages. `set_map`, `publish` and `send` may be called from any thread.

    Args:
        name: name of the robot, part of the link.
        on_event: called on the server's thread for each request; must not block.
    """

    def __init__(self, name: str, on_event: Callable[[FromBrowser], object]) -> None:
        self.name, self.on_event = name, on_event
        self.browsers: set[Browser] = set()
        self.map: tuple[str, bytes] = ("", b"")
        """Digest and packed cells."""
        self.loop: asyncio.AbstractEventLoop | None = None
        """The server's event loop; None before the server starts."""

    def set_map(self, digest: str, zlib_cells: bytes) -> None:
        """Set the map's packed cells, which pages fetch by the digest."""
        self.map = (digest, zlib_cells)

    def publish(self, frames: Mapping[str, Any]) -> None:
        """Send frames to all pages."""
        if self.browsers:
            self._soon(self._offer_all, encoded(frames))

    def send(self, browser: Browser, frames: Mapping[str, Any]) -> None:
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
    """Encode each frame as a member of a JSON object."""
    return {
        topic: b'"%s":%s' % (topic.encode(), msgspec.json.encode(frame))
        for topic, frame in frames.items()
    }
