"""Where and how a page is served, whatever it shows."""

import secrets
import ssl
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from live_view.admission import Address
from live_view.page_server import PageServer
from live_view.room import Room
from protocol.errors import SettingsError


@dataclass(frozen=True, kw_only=True)
class PageOptions:
    """What a person asked for."""

    address: Address
    """Away from loopback the link holds a token."""
    allow_commands: bool = False
    """Obey buttons away from loopback too."""
    open_browser: bool = False
    by_hand: bool = False
    """The arrow keys drive the simulated robot from the beginning."""
    story: str = ""
    """Name of the world whose captions explain what happens; empty: no captions."""
    beside: str = ""
    """Name of a robot that is the same one localized by AMCL, for a second map; empty: none."""
    certificate: Path | None = None
    """PEM; with it the page is served by HTTPS."""
    private_key: Path | None = None

    @property
    def obeys_commands(self) -> bool:
        """Whether buttons are there and obeyed."""
        return self.allow_commands or self.address.is_loopback


@contextmanager
def opened_page(
    options: PageOptions, rooms: Sequence[Room], say: Callable[[str], None]
) -> Iterator[None]:
    """Serve until the block ends.

    Args:
        options: where, and how.
        rooms: one for each robot.
        say: told the link once it can be opened.

    Raises:
        SettingsError: the address or the certificate cannot be used.
    """
    token = "" if options.address.is_loopback else secrets.token_urlsafe(18)
    tls = _tls_context(options)
    commands = options.obeys_commands
    with PageServer(options.address, token, rooms, commands=commands, tls=tls) as server:
        say(server.link)
        if options.open_browser:
            webbrowser.open(server.link)
        yield


def _tls_context(options: PageOptions) -> ssl.SSLContext | None:
    certificate, key = options.certificate, options.private_key
    if certificate is None and key is None:
        return None
    if certificate is None or key is None:
        missing = "--certificate" if certificate is None else "--private-key"
        raise SettingsError(key=missing, problem=f"{missing} is missing: HTTPS needs both")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(certificate, key)
    except OSError as error:  # ssl.SSLError is one
        problem = f"--certificate {certificate}, --private-key {key}: {error.strerror or error}"
        raise SettingsError(key="--certificate", problem=problem) from error
    return context
