import pytest

from clustermcl.protocol.errors import SettingsError
from clustermcl.view.admission import DEFAULT_PORT, Address, Admission, parsed_address

HERE = Admission(Address("127.0.0.1", 8350))
THERE = Admission(Address("0.0.0.0", 8350), token="secret")


@pytest.mark.parametrize(("text", "host", "port", "loopback"), [
    ("127.0.0.1:80", "127.0.0.1", 80, True),
    ("localhost", "localhost", DEFAULT_PORT, True),
    ("robot.example", "robot.example", DEFAULT_PORT, False),
    (":9000", "127.0.0.1", 9000, True),
    ("[::1]:9000", "::1", 9000, True),
    ("0.0.0.0:0", "0.0.0.0", 0, False),
])  # fmt: skip
def test_addresses_are_parsed(text: str, host: str, port: int, loopback: bool) -> None:
    assert parsed_address(text) == Address(host, port)
    assert Address(host, port).is_loopback is loopback


@pytest.mark.parametrize("text", ["", "x:y", "x:70000", "http://x", "a/b", "u@h:1", "[::1"])
def test_malformed_addresses_are_refused(text: str) -> None:
    with pytest.raises(SettingsError, match="--listen"):
        parsed_address(text)


NAME = THERE.cookie.partition("=")[0]
OWN, EVIL = "http://r:8350", "http://evil.example"


@pytest.mark.parametrize(("admission", "target", "headers", "socket", "problem"), [
    (HERE, "/live", {"host": "127.0.0.1:8350", "origin": "http://127.0.0.1:8350"}, True, ""),
    (HERE, "/live", {"host": "localhost:8350", "origin": "http://localhost:8350"}, True, ""),
    *((HERE, "/live", {"host": "127.0.0.1:8350", "origin": origin}, True, "may not connect")
      for origin in (EVIL, "null", "", "http://127.0.0.1:1")),
    (HERE, "/", {"host": "evil.example:8350", "origin": EVIL}, False, "this page is served at"),
    (HERE, "/", {"host": "evil.example:8350", "origin": EVIL}, True, "this page is served at"),
    (THERE, "/", {"host": "r:8350"}, False, "token"),
    (THERE, "/?token=guess", {"host": "r:8350"}, False, "token"),
    (THERE, "/?token=secret", {"host": "r:8350"}, False, ""),
    (THERE, "/live", {"host": "r:8350", "origin": OWN, "cookie": f"a=b; {NAME}=secret"}, True, ""),
    (THERE, "/live", {"host": "r:8350", "origin": OWN, "cookie": f"{NAME}=guess"}, True, "token"),
    (THERE, "/live", {"host": "r:8350", "origin": EVIL, "cookie": f"{NAME}=secret"}, True,
     "may not connect"),
])  # fmt: skip
def test_only_own_pages_with_the_token_or_its_cookie_get_in(
    admission: Admission, target: str, headers: dict[str, str], socket: bool, problem: str
) -> None:
    said = admission.problem(target, headers, socket=socket)
    assert (problem in said) if problem else said == ""


def test_the_link_has_the_token_and_loopback_needs_none() -> None:
    assert (HERE.cookie, HERE.link) == ("", "http://127.0.0.1:8350/")
    assert THERE.link == "http://0.0.0.0:8350/?token=secret"
    assert "HttpOnly" in THERE.cookie
    assert "SameSite=Strict" in THERE.cookie
