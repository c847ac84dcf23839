"""One open page: its requests, and the frames that wait for it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from clustermcl.view.commands import AskAdvice, Command, Drawn, ShowEarlier, ShowPast

MESSAGES_AHEAD = 6
"""Limit for unacknowledged messages to a page that does not report that it is slow."""


class Browser:
    """One open page, to which frames are sent no faster than it draws them.

    A frame is a state, so a newer frame replaces a waiting one of the same topic: a slow page skips
    frames, and at most one frame of each topic waits. Use an object in the server's thread only.
    `send` does not wait.
    """

    def __init__(self, send: Callable[[bytes], None]) -> None:
        self._send = send
        self._waiting: dict[str, bytes] = {}
        self._undrawn, self._max_undrawn = 0, MESSAGES_AHEAD

    def offer(self, frames: Mapping[str, bytes]) -> None:
        self._waiting.update(frames)
        self._send_waiting()

    def on_drawn(self, drawn: Drawn) -> None:
        self._undrawn = max(self._undrawn - drawn.count, 0)
        self._max_undrawn = 1 if drawn.slow else MESSAGES_AHEAD
        self._send_waiting()

    def _send_waiting(self) -> None:
        if self._waiting and self._undrawn < self._max_undrawn:
            message = b"{" + b",".join(self._waiting.values()) + b"}"
            self._waiting.clear()
            self._undrawn += 1
            self._send(message)


class PageOpened:
    """A page was just opened, and needs all frames."""


@dataclass(frozen=True)
class FromBrowser:
    """A request of a page."""

    browser: Browser
    request: PageOpened | ShowPast | ShowEarlier | AskAdvice | Command


def encoded(frames: Mapping[str, Any]) -> dict[str, bytes]:
    """Encode each frame as a member of a JSON object."""
    return {
        topic: b'"%s":%s' % (topic.encode(), msgspec.json.encode(frame))
        for topic, frame in frames.items()
    }
