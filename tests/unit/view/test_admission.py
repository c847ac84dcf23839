import msgspec
import pytest

from clustermcl.protocol.answers import Kidnap, Relocalize, SetPose, Update
from clustermcl.protocol.errors import MalformedMessageError, SettingsError
from clustermcl.view import commands
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
      for origin in (EVIL, "null", "", "http://[", "http://127.0.0.1:1")),
    (HERE, "/", {"host": "evil.example:8350", "origin": EVIL}, False, "this page is served at"),
    (HERE, "/", {"host": "evil.example:8350", "origin": EVIL}, True, "this page is served at"),
    (Admission(Address("127.0.0.1", 80)), "/", {"host": "localhost"}, False, ""),
    (HERE, "/live", {"host": "[::1]:9", "origin": "http://[::1]:9"}, True, ""),  # a tunnel
    (THERE, "/", {"host": "r:8350"}, False, "token"),
    (THERE, "//[?token=guess", {"host": "r:8350"}, False, "token"),
    (THERE, "/?token=secret", {"host": "r:8350"}, False, ""),
    *((THERE, "/live", {"host": "r:8350", "origin": OWN, "cookie": f"{other}; {NAME}=secret"}, True,
       "") for other in ("a=b", 'a={"b": "c"}', "\udcff", f"x{NAME}=x")),
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


COMMAND = {"sender": "view", "command_id": "id"}
POSE = (1.0, 2.5, -3.0)


@pytest.mark.parametrize(
    ("text", "request_of_the_page"),
    [
        ('{"type": "drawn"}', commands.Drawn()),
        ('{"type": "drawn", "count": 3, "slow": true}', commands.Drawn(3, slow=True)),
        ('{"type": "relocalize"}', Relocalize(**COMMAND)),
        ('{"type": "set_pose", "pose": [1, 2.5, -3]}', SetPose(**COMMAND, pose=POSE)),
        ('{"type": "set_pose", "pose": [1, 2.5, -3], "position_sigma_m": 0.2}',
         SetPose(**COMMAND, pose=POSE, position_sigma_m=0.2)),
        ('{"type": "update"}', Update(**COMMAND)),
        ('{"type": "advise"}', commands.AskAdvice()),
        ('{"type": "kidnap"}', Kidnap(**COMMAND)),
        ('{"type": "kidnap", "pose": [1, 2.5, -3]}', Kidnap(**COMMAND, pose=POSE)),
        ('{"type": "past", "step": 7}', commands.ShowPast(7)),
        ('{"type": "earlier", "before": 7}', commands.ShowEarlier(7)),
    ],
)  # fmt: skip
def test_requests_of_the_page_are_parsed(text: str, request_of_the_page: commands.Request) -> None:
    parsed = commands.parsed_request(text)
    if isinstance(parsed, Relocalize | SetPose | Update | Kidnap):
        assert parsed != commands.parsed_request(text), "each command has an id of its own"
        parsed = msgspec.structs.replace(parsed, command_id="id")
    assert parsed == request_of_the_page


@pytest.mark.parametrize("text", [
    "", "[]", b"\xff", '{"type": "drawn", "x": ' + 970 * "[", '{"type": "shutdown"}',
    '{"type": ["set_pose"]}', '{"type": "kidnap", "pose": [1e999, 0, 0]}',
    '{"type": "drawn", "more": 1}', '{"type": "drawn", "count": -1}',
    '{"type": "past", "step": -1}', '{"type": "past", "step": 1.5}', '{"type": "set_pose"}',
    *(f'{{"type": "set_pose", "pose": {pose}}}' for pose in (
        "[1, 2]", "[1, 2, 1e999]", "[1e9, 2, 3]")),
    '{"type": "set_pose", "pose": [1, 2, 3], "position_sigma_m": 0}',
])  # fmt: skip
def test_malformed_requests_are_refused(text: str | bytes) -> None:
    with pytest.raises(MalformedMessageError):
        commands.parsed_request(text)
