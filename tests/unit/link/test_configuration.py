import json
from contextlib import suppress
from pathlib import Path

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.link.configuration import (
    as_zenoh,
    check_endpoint,
    client_configuration,
    patient,
    router_configuration,
)
from clustermcl.protocol.errors import SettingsError
from clustermcl.runtime.settings import RobotSettings, ZenohSettings

REPOSITORY = Path(__file__).parents[3]


@pytest.mark.parametrize(
    "endpoint",
    [
        "tcp/127.0.0.1:7447",
        "tcp/[::1]:7447",
        "tcp/[fe80::1%eth0]:7447",
        "tcp/0.0.0.0:1#iface=eth0",
        "tls/robot-7.example:65535",
        "unixsock-stream//run/clustermcl/router.sock",
    ],
)
def test_valid_endpoints_are_accepted(endpoint: str) -> None:
    check_endpoint(endpoint)


@pytest.mark.parametrize(
    "endpoint",
    [
        *("", "127.0.0.1:7447", "udp/127.0.0.1:7447", "tcp:/127.0.0.1:7447", "tcp/127.0.0.1"),
        *("tcp/:7447", "tcp/::1:7447", "tcp/host:0", "tcp/host:65536", "tls/host:port"),
        *("unixsock-stream/relative.sock", "unixsock-stream//" + "x" * 107),
    ],
)
def test_invalid_endpoints_are_refused(endpoint: str) -> None:
    with pytest.raises(SettingsError, match=r"zenoh\.router = ") as caught:
        check_endpoint(endpoint)
    assert repr(endpoint) in str(caught.value)


@given(st.text())
def test_any_other_text_is_an_endpoint_or_a_settings_error(endpoint: str) -> None:
    with suppress(SettingsError):
        check_endpoint(endpoint)


def test_a_client_connects_only_to_its_router() -> None:
    config = as_zenoh(client_configuration(ZenohSettings(), RobotSettings(name="r1")))
    expected: dict[str, object] = {
        "mode": "client",
        "namespace": "r1",
        "connect/endpoints": ["tcp/127.0.0.1:7447"],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": 2000,
        "queries_default_timeout": 1000,
    }
    assert {key: json.loads(config.get_json(key)) for key in expected} == expected


def test_the_deployed_router_file_is_the_routers_configuration() -> None:
    ours = as_zenoh(router_configuration(ZenohSettings(router="tcp/0.0.0.0:7447")))
    deployed = zenoh.Config.from_file(str(REPOSITORY / "deploy" / "router.json5"))
    assert json.loads(str(deployed)) == json.loads(str(ours))


@pytest.mark.parametrize(
    ("endpoint", "added"),
    [
        ("tcp/0.0.0.0:1", ""),
        ("tls/host:1", "#tls_handshake_timeout_ms=600000"),
        ("tls/host:1#iface=eth0", ";tls_handshake_timeout_ms=600000"),
        ("tls/host:1#tls_handshake_timeout_ms=9", ""),
    ],
)
def test_a_tls_listener_is_patient_by_default(endpoint: str, added: str) -> None:
    assert patient(endpoint) == endpoint + added
