"""Which requests may open the page."""

import pytest

from live_view.admission import DEFAULT_PORT, Address, Admission, parsed_address
from protocol.errors import SettingsError

HERE = Admission(Address("127.0.0.1", 8350))
THERE = Admission(Address("0.0.0.0", 8350), token="secret")


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("127.0.0.1:80", "127.0.0.1", 80),
        ("robot.example", "robot.example", DEFAULT_PORT),
        (":9000", "127.0.0.1", 9000),
        ("[::1]:9000", "::1", 9000),
        ("0.0.0.0:0", "0.0.0.0", 0),
    ],
)
def test_addresses_are_parsed(text: str, host: str, port: int) -> None:
    assert parsed_address(text) == Address(host, port)


@pytest.mark.parametrize("text", ["", "x:y", "x:70000", "http://x", "a/b", "u@h:1", "[::1"])
def test_malformed_addresses_are_refused(text: str) -> None:
    with pytest.raises(SettingsError, match="--listen"):
        parsed_address(text)


@pytest.mark.parametrize(
    ("host", "loopback"),
    [("127.0.0.1", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("r.x", False)],
)
def test_loopback_addresses_are_recognised(host: str, loopback: bool) -> None:
    assert Address(host, 1).is_loopback is loopback


def test_a_page_of_this_machine_may_open_the_socket() -> None:
    for name in ("127.0.0.1:8350", "localhost:8350"):
        headers = {"host": name, "origin": f"http://{name}"}
        assert HERE.problem("/live", headers, socket=True) == ""


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "", "http://127.0.0.1:1"])
def test_a_foreign_page_may_not_open_the_socket(origin: str) -> None:
    headers = {"host": "127.0.0.1:8350", "origin": origin}
    assert "may not connect" in HERE.problem("/live", headers, socket=True)


def test_a_foreign_host_name_for_loopback_is_refused() -> None:
    headers = {"host": "evil.example:8350", "origin": "http://evil.example:8350"}
    for socket in (False, True):
        assert "this page is served at" in HERE.problem("/", headers, socket=socket)


def test_other_addresses_need_the_token() -> None:
    headers = {"host": "robot.example:8350"}
    assert "token" in THERE.problem("/", headers, socket=False)
    assert "token" in THERE.problem("/?token=guess", headers, socket=False)
    assert THERE.problem("/?token=secret", headers, socket=False) == ""
    assert THERE.link == "http://0.0.0.0:8350/?token=secret"


def test_the_cookie_replaces_the_token() -> None:
    name, _, rest = THERE.cookie.partition("=")
    assert "HttpOnly" in rest
    assert "SameSite=Strict" in rest
    headers = {"host": "r:8350", "origin": "http://r:8350", "cookie": f"a=b; {name}=secret"}
    assert THERE.problem("/live", headers, socket=True) == ""
    wrong = {**headers, "cookie": f"{name}=guess"}
    assert "token" in THERE.problem("/live", wrong, socket=True)


def test_a_foreign_page_may_not_open_the_socket_even_with_the_cookie() -> None:
    cookie = THERE.cookie.partition(";")[0]
    headers = {"host": "r:8350", "origin": "http://evil.example", "cookie": cookie}
    assert "may not connect" in THERE.problem("/live", headers, socket=True)


def test_loopback_needs_neither_token_nor_cookie() -> None:
    assert HERE.cookie == ""
    assert HERE.link == "http://127.0.0.1:8350/"
