import http.client
import json
import re
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, ConnectionClosedError, InvalidStatus
from websockets.sync.client import ClientConnection

from clustermcl.runtime.supervisor import python_module
from tests.integration.conftest import StartProcess
from tests.integration.free_port import free_port
from tests.integration.processes import RunningProcess
from tests.integration.view.page import frame_of, opened
from tests.integration.view.stage import Stage
from tests.integration.waiting import PATIENCE_S, wait_until
from tests.unit.view.messages import belief


@pytest.fixture
def no_router(tmp_path: Path) -> str:
    return f"zenoh.router=unixsock-stream/{tmp_path}/r.sock"


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """Of a page on loopback, started as a person types it; no router is there."""
    folder, chosen = tmp_path_factory.mktemp("page"), free_port()
    words = ["--quiet", "view", "--listen", f"127.0.0.1:{chosen}", "--robot", "r1"]
    words += ["--set", f"zenoh.router=unixsock-stream/{folder}/r.sock"]
    process = RunningProcess(python_module("clustermcl", *words), folder, "view")
    process.wait_for("look at")
    assert process.err == f"clustermcl: look at http://127.0.0.1:{chosen}/\n"
    yield chosen
    with opened_at(chosen) as page:
        page.recv(PATIENCE_S)
        process.send_signal(signal.SIGTERM)
        assert process.wait() == 0, "an open page does not hold it"


def got(port: int, path: str, host: str = "") -> tuple[int, dict[str, str], str]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    connection.request("GET", path, headers={"Host": host or f"127.0.0.1:{port}"})
    answer = connection.getresponse()
    headers = {name.lower(): value for name, value in answer.getheaders()}
    result = answer.status, headers, answer.read().decode()
    connection.close()
    return result


def opened_at(port: int, *, cookie: str = "") -> ClientConnection:
    headers = {"Cookie": cookie} if cookie else {}
    return opened(f"http://127.0.0.1:{port}/", additional_headers=headers)


def test_a_page_may_load_nothing_from_elsewhere(port: int) -> None:
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
    for path in ("/nothing", "//[", "/../pyproject.toml", "/map/abc", "/static/app.js"):
        assert got(port, path)[0] == 404, path
    with opened_at(port) as page:
        assert json.loads(page.recv(PATIENCE_S))["system"]["robot"] == "r1"


def done(page: ClientConnection) -> str:
    page.send('{"type": "relocalize"}')
    return str(frame_of(page, "done")["problem"])


def test_without_a_system_a_command_is_answered_with_the_reason(port: int) -> None:
    with opened_at(port) as page:
        assert "no answer" in done(page)


def test_a_browser_that_sends_malformed_messages_is_disconnected_and_disturbs_no_other(
    port: int,
) -> None:
    for rubbish in ("{}", "x" * 5000, '{"type": "set_pose", "pose": [1e99, 0, 0]}'):
        with opened_at(port) as page:
            page.recv(PATIENCE_S)
            page.send(rubbish)
            with pytest.raises(ConnectionClosedError):
                all(page.recv(PATIENCE_S) for _ in range(20))  # some pictures were under way
    with opened_at(port) as page:
        assert "system" in json.loads(page.recv(PATIENCE_S))


def test_on_other_addresses_the_page_needs_the_token_and_is_read_only(
    start_process: StartProcess, no_router: str
) -> None:
    port = free_port()
    words = ("--set", no_router, "--listen", f"0.0.0.0:{port}")
    process = start_process(python_module("clustermcl.view", *words))
    process.wait_for("look at")
    token = re.search(r"\?token=([\w-]+)", process.err)
    assert token is not None
    assert [got(port, path)[0] for path in ("/", "/app.js")] == [403, 403]
    status, headers, _ = got(port, f"/?token={token[1]}")
    assert status == 200
    with pytest.raises(InvalidStatus):
        opened_at(port)
    with opened_at(port, cookie=headers["set-cookie"].partition(";")[0]) as page:
        system = json.loads(page.recv(PATIENCE_S))["system"]
        assert (system["link"], system["commands"]) == ("no router", False)
        assert "is read-only" in done(page)
    assert process.is_running()


def test_a_port_in_use_is_refused_in_one_line(
    start_process: StartProcess, no_router: str, port: int
) -> None:
    words = ("--set", no_router, "--listen", f"127.0.0.1:{port}")
    process = start_process(python_module("clustermcl.view", *words))
    assert process.wait() == 2
    assert "in use" in process.err
    assert process.err.count("\n") == 1


STEPS, PLACES = 1000, 16


def test_a_page_that_requests_and_never_reads_is_disconnected_and_delays_no_other() -> None:
    with Stage() as stage:
        for step in range(STEPS):
            stage.picture.on_belief(belief(step, *range(PLACES)))
        with opened(stage.server.link, max_queue=1, ping_interval=None) as deaf:

            def asked_for_more() -> bool:
                stage.pump()
                try:
                    deaf.send('{"type": "earlier", "before": 1000}')
                    deaf.send('{"type": "drawn", "count": 100}')
                except ConnectionClosed:
                    return True
                return False

            wait_until(asked_for_more)
        with opened(stage.server.link, max_size=None) as other:
            reported: dict[str, Any] = {}

            def has_newest_step() -> bool:
                stage.pump()
                with suppress(TimeoutError):
                    reported.update(json.loads(other.recv(0.05)))
                return "step" in reported

            wait_until(has_newest_step)
            assert reported["step"]["step"] == STEPS - 1
