"""The web server of a robot's page: serves its files, the map and the WebSocket in a thread."""

import asyncio
import logging
import secrets
import socket
import sys
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from http import HTTPStatus
from typing import Any, Self

from websockets.asyncio.server import ServerConnection, broadcast, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request as HttpRequest
from websockets.http11 import Response

from clustermcl.protocol.errors import MalformedMessageError, SettingsError
from clustermcl.protocol.message import MAX_ID_CHARACTERS
from clustermcl.runtime.caller import caller
from clustermcl.view import commands
from clustermcl.view.admission import Address, Admission
from clustermcl.view.browser import Browser, FromBrowser, PageOpened, encoded
from clustermcl.view.picture import Picture
from clustermcl.view.saved_page import static_files

SOCKET_PATH = "live"
MAX_BROWSERS = 100
MAX_UNREAD_BYTES = 8_000_000
"""Limit for the bytes that wait to be sent to a browser; the largest message has a tenth."""
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


def print_link(link: str) -> None:
    sys.stderr.write(f"clustermcl: look at {link}\n")
    sys.stderr.flush()


class PageServer:
    """A web server that runs in a thread within its ``with`` block, and prints its link.

    Port 0 selects a free port. Elsewhere than on loopback, the link contains a token. Of the
    picture it reads the map. `on_event` is called in the server's thread with each request of a
    page; it must not block.

    Raises:
        SettingsError: the address is not of this machine, or in use.
    """

    def __init__(
        self,
        address: Address,
        picture: Picture,
        on_event: Callable[[FromBrowser], object],
        *,
        obeys_commands: bool = False,
    ) -> None:
        token = "" if address.is_loopback else secrets.token_urlsafe(18)
        self._listening = _listening(address)
        port = int(self._listening.getsockname()[1])
        self._admission = Admission(Address(address.host, port), token)
        self._picture, self._on_event, self._commands = picture, on_event, obeys_commands
        self._browsers: set[Browser] = set()
        self._files = static_files()
        self._stopping = asyncio.Event()
        self._started: Future[asyncio.AbstractEventLoop] = Future()
        self._thread = threading.Thread(
            target=lambda: asyncio.run(self._serve()), name="page server", daemon=True
        )

    @property
    def link(self) -> str:
        return self._admission.link

    def __enter__(self) -> Self:
        self._thread.start()
        self._started.result(_STARTED_WITHIN_S)
        print_link(self.link)
        return self

    def __exit__(self, *_error: object) -> None:
        self._started.result().call_soon_threadsafe(self._stopping.set)
        self._thread.join()

    def publish(self, frames: Mapping[str, Any]) -> None:
        """Send frames to all pages; in any thread."""
        if self._browsers:
            self._started.result().call_soon_threadsafe(self._offer_all, encoded(frames))

    def send(self, browser: Browser, frames: Mapping[str, Any]) -> None:
        """Send frames to one page; in any thread."""
        self._started.result().call_soon_threadsafe(browser.offer, encoded(frames))

    def _offer_all(self, frames: Mapping[str, bytes]) -> None:
        for browser in self._browsers:
            browser.offer(frames)

    async def _serve(self) -> None:
        quiet = logging.getLogger("clustermcl.view.websockets")
        quiet.setLevel(logging.CRITICAL)  # refused connections are not logged
        async with serve(
            self._talk,
            sock=self._listening,
            process_request=self._answer,
            compression=None,
            max_size=commands.MAX_REQUEST_BYTES,
            server_header=None,
            close_timeout=0.5,
            logger=quiet,
        ):
            self._started.set_result(asyncio.get_running_loop())
            await self._stopping.wait()

    def _answer(self, _connection: ServerConnection, request: HttpRequest) -> Response | None:
        """Answer or refuse an HTTP request; None: open the WebSocket."""
        headers = {name.lower(): value for name, value in request.headers.raw_items()}
        path = request.path.partition("?")[0].removeprefix("/")
        opens_socket = path == SOCKET_PATH
        if problem := self._admission.problem(request.path, headers, socket=opens_socket):
            return _response(HTTPStatus.FORBIDDEN, problem.encode(), {})
        if opens_socket and len(self._browsers) >= MAX_BROWSERS:
            return _response(HTTPStatus.SERVICE_UNAVAILABLE, b"too many pages are open", {})
        return None if opens_socket else self._content(path or "index.html")

    def _content(self, name: str) -> Response:
        grid_map = self._picture.map
        if grid_map is not None and name == f"map/{grid_map.digest}":
            packed = {"Content-Type": "application/octet-stream", "Content-Encoding": "deflate"}
            return _response(HTTPStatus.OK, grid_map.zlib_cells, packed)
        if name == "browsers":  # the demo waits for the first browser
            return _response(HTTPStatus.OK, str(len(self._browsers)).encode(), {})
        content = self._files.get(name)
        if content is None:
            return _response(HTTPStatus.NOT_FOUND, b"there is no such page", {})
        more = {"Content-Type": _CONTENT_TYPES[name.rpartition(".")[2]]}
        if name == "index.html" and self._admission.cookie:
            more["Set-Cookie"] = self._admission.cookie
        return _response(HTTPStatus.OK, content, more)

    async def _talk(self, connection: ServerConnection) -> None:
        browser = Browser(lambda data: _send(connection, data))
        self._browsers.add(browser)
        try:
            self._on_event(FromBrowser(browser, PageOpened()))
            async for text in connection:
                self._on_request(browser, commands.parsed_request(text, _sender(connection)))
        except MalformedMessageError as error:
            await connection.close(1008, str(error)[:100])
        except ConnectionClosed:
            pass
        finally:
            self._browsers.discard(browser)

    def _on_request(self, browser: Browser, request: commands.Request) -> None:
        if isinstance(request, commands.Drawn):
            browser.on_drawn(request)
        elif self._commands or isinstance(request, commands.ShowPast | commands.ShowEarlier):
            self._on_event(FromBrowser(browser, request))
        else:
            problem = "this page is read-only: start it with --allow-commands"
            browser.offer(encoded({"done": {"problem": problem}}))


def _sender(connection: ServerConnection) -> str:
    """Return who commands, such as ``view of robot@r1, browser at 10.0.0.7``."""
    address = connection.remote_address
    browser = f", browser at {address[0]}" if address else ""
    return f"{caller('view')}{browser}"[:MAX_ID_CHARACTERS]


def _send(connection: ServerConnection, data: bytes) -> None:
    """Send without waiting; disconnect a browser that has too many bytes to read."""
    if connection.transport.get_write_buffer_size() > MAX_UNREAD_BYTES:
        connection.transport.abort()
    else:
        broadcast([connection], data.decode())


def _response(status: HTTPStatus, body: bytes, more: Mapping[str, str]) -> Response:
    text = {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))}
    headers = Headers({**text, **_SAFE, **more, "Connection": "close"})
    return Response(status.value, status.phrase, headers, body)


def _listening(address: Address) -> socket.socket:
    try:
        return socket.create_server(
            (address.host, address.port),
            family=socket.AF_INET6 if ":" in address.host else socket.AF_INET,
        )
    except OSError as error:
        problem = f"--listen {address.netloc}: {error.strerror or error}; name another"
        raise SettingsError(key="--listen", problem=problem) from error
