import json
import socket
import sys
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
import zenoh

from clustermcl.link.configuration import as_zenoh, router_configuration
from clustermcl.link.router import MIN_PROBES, RouterProbe, client_of
from clustermcl.runtime.settings import ZenohSettings
from tests.integration.conftest import StartProcess
from tests.integration.processes import RunningProcess
from tests.integration.waiting import PATIENCE_S, wait_until

ROUTER = "from clustermcl.link import router; router.LOOK_EVERY_S = 0.5; router.main()"


@pytest.fixture
def narrow_router(
    zenoh_settings: ZenohSettings, tmp_path: Path, start_process: StartProcess
) -> RunningProcess:
    """A router that allows one pending connection: easily blocked for good."""
    configuration = router_configuration(zenoh_settings)
    configuration["transport"]["unicast"] = {"accept_pending": 1, "accept_timeout": 600_000}
    file = tmp_path / "router.json5"
    file.write_text(json.dumps(configuration))
    words = ("--config", str(file), "--set", "log.level=debug")
    process = start_process([sys.executable, "-c", ROUTER, *words])
    process.wait_for("router listens at")
    return process


def test_a_router_that_accepts_no_client_any_more_exits(
    narrow_router: RunningProcess, zenoh_settings: ZenohSettings
) -> None:
    narrow_router.wait_for("clients can connect")
    with ExitStack() as silence:

        def block() -> bool:
            one = silence.enter_context(socket.socket(socket.AF_UNIX))
            with suppress(ConnectionRefusedError):  # it has just ended
                one.connect(zenoh_settings.router.partition("/")[2])
            return not narrow_router.is_running()

        wait_until(block)
    assert narrow_router.wait() == 1
    assert "no client can connect" in narrow_router.err


def test_failures_of_the_probe_count_only_after_a_success(
    narrow_router: RunningProcess, zenoh_settings: ZenohSettings, tmp_path: Path
) -> None:
    """A probe that never connects, for example without a valid certificate, proves nothing."""
    assert narrow_router.is_running()
    file = tmp_path / "no-endpoint.json5"
    file.write_text(
        "{ mode: 'router', listen: { endpoints: { router: [], peer: ['tcp/[::]:0'] } } }"
    )
    never = RouterProbe(zenoh.Config.from_file(str(file)), patience_s=0.1)
    good = RouterProbe(as_zenoh(router_configuration(zenoh_settings)), patience_s=PATIENCE_S)
    for _ in range(2 * MIN_PROBES):
        for one in (good, never):
            one.probe().join()
            assert not one.is_locked_up


@pytest.mark.parametrize(
    ("listens", "looks"),
    [
        ("tcp/0.0.0.0:7447", "tcp/127.0.0.1:7447"),
        ("tcp/[::]:7447", "tcp/[::1]:7447"),
        ("tcp/10.1.2.3:7447#iface=eth0", "tcp/10.1.2.3:7447"),
    ],
)
def test_the_probe_connects_where_the_router_listens(listens: str, looks: str) -> None:
    configuration = router_configuration(ZenohSettings(router="tcp/localhost:1"))
    configuration["listen"]["endpoints"] = [listens]
    client = client_of(as_zenoh(configuration), 1.0)
    assert client["connect"]["endpoints"] == [looks]
    assert client["transport"]["shared_memory"] == {"enabled": False}, "it would be left behind"
