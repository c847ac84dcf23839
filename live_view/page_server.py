"""The page's files, the map and the WebSocket, served by a thread of its own."""

import asyncio
import importlib.resources
import logging
import socket
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from http import HTTPStatus
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlsplit

import msgspec
from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request as HttpRequest
from websockets.http11 import Response

from live_view.admission import Address, Admission
from live_view.backlog import Backlog
from live_view.commands import (
    MAX_REQUEST_BYTES,
    Command,
    Drawn,
    Question,
    ShowEarlier,
    ShowPast,
    parsed_request,
)
from protocol.errors import MalformedMessageError, SettingsError

SOCKET_PATH = "/live"
MAX_BROWSERS = 100
_STARTED_WITHIN_S = 10.0
_CONTENT_TYPES = {
    "html": "text/html; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "svg": "image/svg+xml",
}
_SAFE = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self'; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Browser:
    """One open page, as a handle for whoever answers it."""

    def __init__(self) -> None:
        self.backlog = Backlog({})
        self.woken = asyncio.Event()

    def offer(self, frames: Mapping[str, bytes]) -> None:
        """Give it newer frames; on the server's own thread."""
        self.backlog.offer(frames)
        self.woken.set()


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


class PageServer:
    """Serves until its ``with`` block ends. The other methods may be called from any thread.

    Args:
        address: where; port 0 takes a free one.
        token: wanted of each browser; empty: none.
        on_event: told what browsers do, on the server's thread: put, and return.
        commands: whether buttons are obeyed.
    """

    def __init__(
        self,
        address: Address,
        token: str,
        on_event: Callable[[FromBrowser], object],
        *,
        commands: bool,
    ) -> None:
        self._listening = _listening(address)
        port = int(self._listening.getsockname()[1])
        self._admission = Admission(Address(address.host, port), token)
        self._on_event, self._commands = on_event, commands
        self._files = _static_files()
        self._map: tuple[str, bytes] = ("", b"")
        self._browsers: set[Browser] = set()
        self._loop = asyncio.new_event_loop()
        self._stopping = asyncio.Event()
        self._started: Future[None] = Future()
        self._thread = threading.Thread(target=self._run, name="page server", daemon=True)

    @property
    def link(self) -> str:
        """What a person opens."""
        return self._admission.link

    def __enter__(self) -> Self:
        """Listen."""
        self._thread.start()
        self._started.result(_STARTED_WITHIN_S)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close all pages' sockets."""
        self._loop.call_soon_threadsafe(self._stopping.set)
        self._thread.join()

    def set_map(self, digest: str, zlib_cells: bytes) -> None:
        """The cells that the page fetches next, packed as they came."""
        self._map = (digest, zlib_cells)

    def publish(self, frames: Mapping[str, Any]) -> None:
        """Send frames to every page; a slow one skips those that are replaced meanwhile."""
        encoded = _encoded(frames)
        self._loop.call_soon_threadsafe(self._offer_all, encoded)

    def tell(self, browser: Browser, frames: Mapping[str, Any]) -> None:
        """Send frames to one page."""
        self._loop.call_soon_threadsafe(browser.offer, _encoded(frames))

    def _offer_all(self, frames: Mapping[str, bytes]) -> None:
        for browser in self._browsers:
            browser.offer(frames)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._loop.close()

    async def _serve(self) -> None:
        quiet = logging.getLogger("live_view.websockets")
        quiet.setLevel(logging.CRITICAL)  # strangers who knock are no news
        async with serve(
            self._talk,
            sock=self._listening,
            process_request=self._answer,
            compression=None,
            max_size=MAX_REQUEST_BYTES,
            server_header=None,
            close_timeout=0.5,
            logger=quiet,
        ):
            self._started.set_result(None)
            await self._stopping.wait()

    def _answer(self, _connection: ServerConnection, request: HttpRequest) -> Response | None:
        """Answer what is no WebSocket, or refuse; None lets the WebSocket open."""
        headers = {name.lower(): value for name, value in request.headers.raw_items()}
        path = urlsplit(request.path).path
        opens_socket = path == SOCKET_PATH
        if problem := self._admission.problem(request.path, headers, socket=opens_socket):
            return _response(HTTPStatus.FORBIDDEN, problem.encode(), {})
        if opens_socket:
            if len(self._browsers) >= MAX_BROWSERS:
                return _response(HTTPStatus.SERVICE_UNAVAILABLE, b"too many pages are open", {})
            return None
        digest, cells = self._map
        if digest and path == f"/map/{digest}":
            packed = {"Content-Type": "application/octet-stream", "Content-Encoding": "deflate"}
            return _response(HTTPStatus.OK, cells, packed)
        return self._file("index.html" if path == "/" else path[1:])

    def _file(self, name: str) -> Response:
        content = self._files.get(name)
        if content is None:
            return _response(HTTPStatus.NOT_FOUND, b"there is no such page", {})
        more = {"Content-Type": _CONTENT_TYPES[name.rpartition(".")[2]]}
        if name == "index.html" and self._admission.cookie:
            more["Set-Cookie"] = self._admission.cookie
        return _response(HTTPStatus.OK, content, more)

    async def _talk(self, connection: ServerConnection) -> None:
        browser = Browser()
        self._browsers.add(browser)
        sender = asyncio.create_task(_send(connection, browser))
        try:
            self._on_event(Joined(browser))
            async for text in connection:
                self._hear(browser, text)
        except MalformedMessageError as error:
            await connection.close(1008, str(error)[:100])
        except ConnectionClosed:
            pass
        finally:
            self._browsers.discard(browser)
            sender.cancel()

    def _hear(self, browser: Browser, text: str | bytes) -> None:
        match parsed_request(text):
            case Drawn():
                browser.backlog.on_drawn()
                browser.woken.set()
            case ShowPast() | ShowEarlier() as question:
                self._on_event(Questioned(browser, question))
            case command if self._commands:
                self._on_event(Commanded(browser, command))
            case _:
                problem = "this page may only look: start it with --allow-commands"
                browser.offer(_encoded({"done": {"problem": problem}}))


async def _send(connection: ServerConnection, browser: Browser) -> None:
    """Send what is owed, whenever there is something and the page has drawn the last."""
    try:
        while True:
            await browser.woken.wait()
            browser.woken.clear()
            if frames := browser.backlog.take():
                await connection.send(b"{" + b",".join(frames) + b"}", text=True)
    except ConnectionClosed:
        return


def _encoded(frames: Mapping[str, Any]) -> dict[str, bytes]:
    """Each frame as a member of a JSON object; once for all browsers."""
    return {
        topic: b'"%s":%s' % (topic.encode(), msgspec.json.encode(frame))
        for topic, frame in frames.items()
    }


def _response(status: HTTPStatus, body: bytes, more: Mapping[str, str]) -> Response:
    text = {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))}
    headers = Headers({**text, **_SAFE, **more, "Connection": "close"})
    return Response(status.value, status.phrase, headers, body)


def _static_files() -> dict[str, bytes]:
    folder = importlib.resources.files("live_view") / "static"
    return {file.name: file.read_bytes() for file in folder.iterdir() if file.is_file()}


def _listening(address: Address) -> socket.socket:
    """A socket that listens.

    Raises:
        SettingsError: the address is not this machine's, or is in use.
    """
    try:
        return socket.create_server(
            (address.host, address.port),
            family=socket.AF_INET6 if ":" in address.host else socket.AF_INET,
        )
    except OSError as error:
        problem = f"{address.netloc}: {error.strerror or error}; name another with --listen"
        raise SettingsError(key="--listen", problem=problem) from error
