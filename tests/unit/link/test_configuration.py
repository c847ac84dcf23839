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
    ("endpoint", "hint"),
    [
        ("", "write tcp/HOST:PORT, tls/HOST:PORT or unixsock-stream//PATH"),
        ("127.0.0.1:7447", "write tcp/HOST:PORT, tls"),
        ("udp/127.0.0.1:7447", "write tcp/HOST:PORT, tls"),
        ("tcp:/127.0.0.1:7447", "write tcp/HOST:PORT, tls"),
        ("tcp/127.0.0.1", "write tcp/HOST:PORT"),
        ("tcp/:7447", "write tcp/HOST:PORT"),
        ("tcp/::1:7447", "write tcp/HOST:PORT"),
        ("tcp/host:0", "write tcp/HOST:PORT"),
        ("tcp/host:65536", "write tcp/HOST:PORT"),
        ("tls/host:port", "write tls/HOST:PORT"),
        ("unixsock-stream/relative.sock", "absolute path"),
        ("unixsock-stream//" + "x" * 107, "at most 107 bytes"),
    ],
)
def test_invalid_endpoints_are_refused_with_a_remedy(endpoint: str, hint: str) -> None:
    with pytest.raises(SettingsError) as caught:
        check_endpoint(endpoint)
    assert hint in str(caught.value)
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


@pytest.mark.parametrize("name", ["", "a*", "/a", "a//b", "a#b", "a?"])
def test_a_robots_name_that_cannot_be_a_key_is_refused(name: str) -> None:
    with pytest.raises(SettingsError, match=r"robot\.name = ") as caught:
        as_zenoh(client_configuration(ZenohSettings(), RobotSettings(name=name)))
    assert "\n" not in str(caught.value)
    assert ".rs" not in str(caught.value)


def test_the_deployed_router_file_is_the_routers_configuration() -> None:
    ours = as_zenoh(router_configuration(ZenohSettings(router="tcp/0.0.0.0:7447")))
    deployed = zenoh.Config.from_file(str(REPOSITORY / "deploy" / "router.json5"))
    assert json.loads(str(deployed)) == json.loads(str(ours))


@pytest.mark.parametrize(
    ("endpoint", "listened_at"),
    [
        ("tcp/0.0.0.0:1", "tcp/0.0.0.0:1"),
        ("tls/host:1", "tls/host:1#tls_handshake_timeout_ms=600000"),
        ("tls/host:1#iface=eth0", "tls/host:1#iface=eth0;tls_handshake_timeout_ms=600000"),
        ("tls/host:1#tls_handshake_timeout_ms=9", "tls/host:1#tls_handshake_timeout_ms=9"),
    ],
)
def test_a_tls_listener_is_patient_by_default(endpoint: str, listened_at: str) -> None:
    assert patient(endpoint) == listened_at
