"""Access control of the page: checks the headers of each request before it is answered."""

import hmac
import ipaddress
import re
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import parse_qs, urlsplit

from clustermcl.protocol.errors import SettingsError

DEFAULT_PORT = 8350


@dataclass(frozen=True)
class Address:
    """Host and port at which the page is served."""

    host: str
    port: int

    @property
    def is_loopback(self) -> bool:
        """Whether only programs on this machine can reach the address."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    @property
    def netloc(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


def parsed_address(text: str) -> Address:
    """Parse ``HOST:PORT``, ``HOST`` or ``:PORT``, with an IPv6 address in brackets.

    The default host is 127.0.0.1, the default port `DEFAULT_PORT`.

    Raises:
        SettingsError: the text is not such an address.
    """
    try:
        parts = urlsplit(f"//{text}")
        port = parts.port
    except ValueError as error:
        raise SettingsError(key="--listen", problem=f"--listen: {text!r}: {error}") from None
    if parts.netloc != text or not text or parts.username is not None:
        raise SettingsError(key="--listen", problem=f"--listen: {text!r} is not HOST:PORT")
    return Address(parts.hostname or "127.0.0.1", DEFAULT_PORT if port is None else port)


@dataclass(frozen=True)
class Admission:
    """The rules by which requests are accepted or refused.

    On loopback, the host in a request must be this machine, at any port, which may be a tunnel's:
    another site could make its own name resolve to 127.0.0.1 (DNS rebinding). Otherwise a request
    needs a token, which is in the page's link, and in a cookie that the browser gets with the page.
    The address has the bound port.
    """

    address: Address
    token: str = ""

    @property
    def link(self) -> str:
        token = f"?token={self.token}" if self.token else ""
        return f"http://{self.address.netloc}/{token}"

    @property
    def cookie(self) -> str:
        """Value of the header ``Set-Cookie`` with the token; empty without a token."""
        if not self.token:
            return ""
        return f"{self._cookie_name}={self.token}; Path=/; HttpOnly; SameSite=Strict"

    def problem(self, target: str, headers: Mapping[str, str], *, socket: bool) -> str:
        """Return why a request is refused, or an empty text if it is accepted.

        The headers have lower-case names. Only this page may open a WebSocket.
        """
        host = headers.get("host", "")
        named = Address(re.sub(r":\d*$", "", host).strip("[]"), self.address.port)
        if self.address.is_loopback and not named.is_loopback:
            return f"this page is served at {self.address.netloc}, not at {host!r}"
        if socket and headers.get("origin", "").partition("://")[2] != host:
            return f"a page of {headers.get('origin', 'no origin')!r} may not connect"
        if self.token and not self._knows_token(target, headers):
            return "the token is missing or wrong: open the link that `clustermcl view` printed"
        return ""

    def _knows_token(self, target: str, headers: Mapping[str, str]) -> bool:
        given = parse_qs(target.partition("?")[2]).get("token", [""])[0]
        # Not by `SimpleCookie`, which reads none if another program's cookie is malformed.
        cookie = re.search(rf"(^|; *){self._cookie_name}=([^;]*)", headers.get("cookie", ""))
        given = given or (cookie[2] if cookie else "")
        return hmac.compare_digest(given.encode(errors="replace"), self.token.encode())

    @property
    def _cookie_name(self) -> str:
        return f"clustermcl-{self.address.port}"  # a browser sends a cookie to all ports of a host
