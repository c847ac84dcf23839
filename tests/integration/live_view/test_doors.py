"""Who gets in, and what a page may ask: a real server, without a browser."""

import http.client
import json
import re
import ssl
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosedError, InvalidStatus
from websockets.sync.client import ClientConnection

from process_runtime.supervisor import python_module
from tests.integration.conftest import StartProcess
from tests.integration.free_port import free_port
from tests.integration.live_view.page import opened as open_page
from tests.integration.processes import RunningProcess
from tests.integration.waiting import PATIENCE_S


@pytest.fixture
def nobody(tmp_path: Path) -> str:
    """A router's endpoint without a router."""
    return f"zenoh.router=unixsock-stream/{tmp_path}/r.sock"


@pytest.fixture
def port(start_process: StartProcess, nobody: str) -> int:
    """Of a page on loopback."""
    chosen = free_port()
    served(start_process, nobody, "--listen", f"127.0.0.1:{chosen}")
    return chosen


@pytest.fixture
def open_to_all(start_process: StartProcess, nobody: str) -> Iterator[tuple[int, str]]:
    """Port and token of a page that other machines reach."""
    chosen = free_port()
    process = served(start_process, nobody, "--listen", f"0.0.0.0:{chosen}")
    token = re.search(r"\?token=([\w-]+)", process.err)
    assert token is not None
    yield chosen, token[1]
    assert process.is_running()


def served(start_process: StartProcess, nobody: str, *arguments: str) -> RunningProcess:
    process = start_process(python_module("live_view", "--set", nobody, *arguments))
    process.wait_for("look at")
    return process


def got(port: int, path: str, host: str = "") -> tuple[int, dict[str, str], str]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    connection.request("GET", path, headers={"Host": host or f"127.0.0.1:{port}"})
    answer = connection.getresponse()
    headers = {name.lower(): value for name, value in answer.getheaders()}
    said = answer.status, headers, answer.read().decode()
    connection.close()
    return said


def opened(
    port: int, *, origin: str = "", cookie: str = "", path: str = "live"
) -> ClientConnection:
    headers = {"Cookie": cookie} if cookie else {}
    link = f"http://127.0.0.1:{port}"
    return open_page(f"{link}/", path, origin=origin or link, additional_headers=headers)


def test_the_command_view_passes_its_options_to_the_page(
    start_process: StartProcess, nobody: str
) -> None:
    port = free_port()
    words = ["view", "--listen", f"127.0.0.1:{port}", "--robot", "r1", "--robot", "r2"]
    process = start_process([*python_module("clustermcl"), *words, "--quiet", "--set", nobody])
    process.wait_for(f"look at http://127.0.0.1:{port}/")
    assert [got(port, f"/robot/{robot}/")[0] for robot in ("r1", "r2", "r3")] == [200, 200, 404]
    assert process.err == f"clustermcl: look at http://127.0.0.1:{port}/\n"


def test_the_page_is_served_and_may_load_nothing_from_elsewhere(port: int) -> None:
    status, headers, text = got(port, "/")
    assert status == 200
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "://" not in policy
    for file in re.findall(r'(?:src|href)="([^"]+)"', text):
        found, about, content = got(port, f"/{file}")
        assert found == 200, file
        assert about["x-content-type-options"] == "nosniff"
        assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)", content), file


@pytest.mark.parametrize("path", ["/nothing", "/../pyproject.toml", "/map/abc", "/static/app.js"])
def test_other_paths_are_not_served(port: int, path: str) -> None:
    assert got(port, path)[0] == 404


def test_a_foreign_page_is_refused(port: int) -> None:
    for origin in ("http://evil.example", "null"):
        with pytest.raises(InvalidStatus) as refused:
            opened(port, origin=origin)
        assert refused.value.response.status_code == 403


def test_a_foreign_host_name_for_this_machine_is_refused(port: int) -> None:
    assert got(port, "/", host=f"evil.example:{port}")[0] == 403


def test_away_from_loopback_nothing_is_served_without_the_token(
    open_to_all: tuple[int, str],
) -> None:
    port, token = open_to_all
    assert got(port, "/")[0] == 403
    assert got(port, "/app.js")[0] == 403
    status, headers, _ = got(port, f"/?token={token}")
    assert status == 200
    cookie = headers["set-cookie"].partition(";")[0]
    with opened(port, cookie=cookie) as page:
        assert json.loads(page.recv(PATIENCE_S))["system"]["link"] == "no router"
    with pytest.raises(InvalidStatus):
        opened(port)


def test_away_from_loopback_a_page_may_only_look(open_to_all: tuple[int, str]) -> None:
    port, token = open_to_all
    cookie = got(port, f"/?token={token}")[1]["set-cookie"].partition(";")[0]
    with opened(port, cookie=cookie) as page:
        assert json.loads(page.recv(PATIENCE_S))["system"]["commands"] is False
        page.send('{"type": "relocalize"}')
        while "done" not in (told := json.loads(page.recv(PATIENCE_S))):  # pictures were under way
            page.send('{"type": "drawn"}')
        assert "is read-only" in told["done"]["problem"]


def test_without_a_system_a_command_is_answered_with_the_reason(port: int) -> None:
    with opened(port) as page:
        page.recv(PATIENCE_S)
        page.send('{"type": "drawn"}')
        page.send('{"type": "relocalize"}')
        told = [json.loads(page.recv(PATIENCE_S))]
        while "done" not in told[-1]:  # the picture goes on meanwhile
            page.send('{"type": "drawn"}')
            told.append(json.loads(page.recv(PATIENCE_S)))
        assert "no answer" in told[-1]["done"]["problem"]


@pytest.mark.parametrize(
    "rubbish", ["{}", "x" * 5000, '{"type": "set_pose", "pose": [1e99, 0, 0]}']
)
def test_a_browser_that_sends_rubbish_is_disconnected_and_harms_no_other(
    port: int, rubbish: str
) -> None:
    with opened(port) as page:
        page.recv(PATIENCE_S)
        page.send(rubbish)
        with pytest.raises(ConnectionClosedError):
            all(page.recv(PATIENCE_S) for _ in range(20))  # some pictures were under way
    with opened(port) as page:
        assert "system" in json.loads(page.recv(PATIENCE_S))


def test_each_robot_has_a_page_of_its_own(start_process: StartProcess, nobody: str) -> None:
    port = free_port()
    names = ("--robot", "r1", "--robot", "r2")
    served(start_process, nobody, "--listen", f"127.0.0.1:{port}", *names)
    assert got(port, "/robot/r2/")[0] == 200
    assert got(port, "/robot/r2/app.js")[0] == 200
    assert got(port, "/robot/r3/")[0] == 404
    for name, path in (("r1", "live"), ("r1", "robot/r1/live"), ("r2", "robot/r2/live")):
        with opened(port, path=path) as page:
            system = json.loads(page.recv(PATIENCE_S))["system"]
            assert (system["robot"], system["robots"]) == (name, ["r1", "r2"])
    with pytest.raises(InvalidStatus):
        opened(port, path="robot/r3/live")


def test_with_a_certificate_the_page_is_served_by_https(
    start_process: StartProcess, nobody: str, tmp_path: Path
) -> None:
    certificate, key = self_signed(tmp_path)
    port = free_port()
    tls = ("--certificate", str(certificate), "--private-key", str(key))
    process = served(start_process, nobody, "--listen", f"0.0.0.0:{port}", *tls)
    link = re.search(r"https://0\.0\.0\.0:\d+/(\?token=[\w-]+)", process.err)
    assert link is not None
    context = ssl.create_default_context(cafile=str(certificate))
    connection = http.client.HTTPSConnection("localhost", port, timeout=PATIENCE_S, context=context)
    connection.request("GET", f"/{link[1]}")
    answer = connection.getresponse()
    assert answer.status == 200
    assert "; Secure" in (answer.getheader("set-cookie") or "")
    connection.close()


@pytest.mark.parametrize("given", [["--certificate"], ["--private-key"]])
def test_half_a_certificate_is_refused_in_one_line(
    start_process: StartProcess, nobody: str, tmp_path: Path, given: list[str]
) -> None:
    files = dict(zip(("--certificate", "--private-key"), self_signed(tmp_path), strict=True))
    command = python_module("live_view", "--set", nobody, *given, str(files[given[0]]))
    process = start_process(command)
    assert process.wait() == 2
    assert "HTTPS needs both" in process.err
    assert process.err.count("\n") == 1


def test_an_invalid_certificate_is_refused_in_one_line(
    start_process: StartProcess, nobody: str, tmp_path: Path
) -> None:
    rubbish = tmp_path / "rubbish.pem"
    rubbish.write_text("rubbish")
    files = ("--certificate", str(rubbish), "--private-key", str(rubbish))
    process = start_process(python_module("live_view", "--set", nobody, *files))
    assert process.wait() == 2
    assert "rubbish.pem" in process.err
    assert process.err.count("\n") == 1


def self_signed(folder: Path) -> tuple[Path, Path]:
    certificate, key = folder / "page.pem", folder / "page.key"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256",
         "-nodes", "-days", "2", "-subj", "/CN=localhost", "-addext",
         "subjectAltName=DNS:localhost", "-keyout", str(key), "-out", str(certificate)],
        check=True, capture_output=True,
    )  # fmt: skip
    return certificate, key


def test_a_port_in_use_is_reported_in_one_line(
    start_process: StartProcess, nobody: str, port: int
) -> None:
    second = python_module("live_view", "--set", nobody, "--listen", f"127.0.0.1:{port}")
    process = start_process(second)
    assert process.wait() == 2
    assert "in use" in process.err
    assert process.err.count("\n") == 1


def test_the_process_ends_on_a_signal_despite_an_open_page(
    start_process: StartProcess, nobody: str
) -> None:
    port = free_port()
    process = served(start_process, nobody, "--listen", f"127.0.0.1:{port}")
    with opened(port) as page:
        page.recv(PATIENCE_S)
        process.send_signal(15)
        assert process.wait() == 0
