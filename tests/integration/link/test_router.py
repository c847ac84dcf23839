import signal
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from clustermcl.protocol.errors import SettingsError
from clustermcl.runtime.settings import ZenohSettings
from clustermcl.runtime.supervisor import python_module
from tests.integration.conftest import OpenClient, StartProcess
from tests.integration.processes import RunningProcess
from tests.integration.routers import open_router
from tests.integration.waiting import wait_until


def test_a_router_ends_on_a_signal_and_a_killed_one_does_not_block_the_next(
    start_router: Callable[[], RunningProcess],
) -> None:
    killed = start_router()
    killed.send_signal(signal.SIGKILL)
    assert killed.wait() == -signal.SIGKILL
    process = start_router()
    process.send_signal(signal.SIGINT)
    assert process.wait() == 0
    assert process.out == ""


def test_a_router_that_a_client_starts_has_more_threads_than_a_machine_has_links(
    zenoh_settings: ZenohSettings,
    start_router: Callable[[], RunningProcess],
    open_client: OpenClient,
) -> None:
    first = start_router()
    open_client()
    first.kill()
    Path(zenoh_settings.router.partition("/")[2]).unlink(missing_ok=True)
    second = start_router()

    def receiving() -> int:
        names = Path(f"/proc/{second.pid}/task").glob("*/comm")
        return sum(name.read_text().startswith("rx-") for name in names)

    wait_until(lambda: receiving() == 16)  # the client has come back: they are started with a link


def test_a_port_in_use_prints_one_line_and_exits_with_2(start_process: StartProcess) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        process = start_process(
            python_module("clustermcl.link.router", "--set", f"zenoh.router={endpoint}")
        )
        assert process.wait() == 2
    assert process.err.startswith(f"router: {endpoint} is in use: ")
    assert process.err.count("\n") == 1


@pytest.mark.parametrize(
    ("endpoint", "message"),
    [
        ("tcp/192.0.2.1:7447", "cannot listen at tcp/192.0.2.1:7447: "),  # TEST-NET, never ours
        ("unixsock-stream//no/such/folder/x", "cannot listen at unixsock-stream//no/such/folder/x"),
    ],
)
def test_an_endpoint_that_cannot_be_listened_at_is_named(endpoint: str, message: str) -> None:
    with pytest.raises(SettingsError) as caught, open_router(ZenohSettings(router=endpoint)):
        pass
    assert message in str(caught.value)
    assert ".rs" not in str(caught.value)


@pytest.mark.parametrize("text", [None, "{ mode: 'router', ", "{ nod: 1 }"])
def test_a_file_that_is_no_configuration_is_named(
    text: str | None, tmp_path: Path, start_process: StartProcess
) -> None:
    file = tmp_path / "router.json5"
    if text is not None:
        file.write_text(text)
    process = start_process(python_module("clustermcl.link.router", "--config", str(file)))
    assert process.wait() == 2
    assert process.err.startswith(f"router: {file}: ")
    assert process.err.count("\n") == 1
