"""The bridge as a process. The libraries for ROS are an optional extra, imported late."""

from importlib.util import find_spec

from clustermcl.protocol.errors import ClusterMclError
from clustermcl.runtime.main import Invocation, process_main
from clustermcl.runtime.settings import Settings

_PACKAGES = ("rosbags", "xxhash")


class Ros2NotInstalledError(ClusterMclError):
    """The optional libraries for ROS 2 are not installed."""

    def __init__(self, package: str) -> None:
        self.package, self.extra = package, "ros2"
        super().__init__(f"ROS 2 needs {package!r}: pip install 'clustermcl[{self.extra}]'")


def main() -> None:
    process_main(
        "ros2",
        run_ros2_bridge,
        describe="Stands in for nav2's AMCL on a robot that speaks ROS 2 over rmw_zenoh.",
    )


def run_ros2_bridge(invocation: Invocation) -> None:
    check_ros2(invocation.settings)
    from clustermcl.ros2.bridge import serve_robot  # noqa: PLC0415 - needs the extra

    serve_robot(invocation.settings, invocation.process, invocation.stop)


def check_ros2(settings: Settings) -> None:
    """Check that the bridge can run, before any process is started."""
    for package in _PACKAGES:
        if find_spec(package) is None:
            raise Ros2NotInstalledError(package)
    from clustermcl.ros2.robot_session import node_name  # noqa: PLC0415 - needs the extra

    node_name(settings.ros2)
