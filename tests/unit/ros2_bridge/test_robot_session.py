import pytest

from ros2_bridge.robot_session import is_of_this_machine


@pytest.mark.parametrize(
    ("router", "expected"),
    [
        ("tcp/localhost:7447", True),
        ("tcp/127.0.0.1:7447", True),
        ("tcp/[::1]:7447", True),
        ("unixsock-stream//run/router.sock", True),
        ("tcp/192.0.2.10:7447", False),
        ("tcp/localhost.example:7447", False),
        ("tls/localhost:7447", False),
    ],
)
def test_only_local_endpoints_without_tls_make_the_session_a_peer(
    router: str, *, expected: bool
) -> None:
    assert is_of_this_machine(router) is expected
