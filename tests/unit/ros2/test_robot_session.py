import pytest

from clustermcl.protocol.errors import SettingsError
from clustermcl.ros2.robot_session import is_of_this_machine, node_name
from clustermcl.runtime.ros2_settings import Ros2Settings


@pytest.mark.parametrize(
    ("given", "namespace"),
    [("", ""), ("/", ""), ("/a", "/a"), ("a", "/a"), ("/a/b_1/", "/a/b_1")],
)
def test_a_namespace_is_names_between_slashes(given: str, namespace: str) -> None:
    assert node_name(Ros2Settings(namespace=given)).namespace == namespace


@pytest.mark.parametrize(
    ("setting", "value"),
    [("namespace", "/a b"), ("namespace", "/a//b"), ("node_name", "a/b"), ("map_topic", "1map")],
)
def test_a_name_that_ros_does_not_allow_is_refused(setting: str, value: str) -> None:
    with pytest.raises(SettingsError, match=f"ros2.{setting} = "):
        node_name(Ros2Settings(**{setting: value}))  # type: ignore[arg-type] # of one type


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
