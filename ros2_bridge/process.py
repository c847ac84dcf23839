"""The bridge as a process. What speaks ROS is an extra, imported once it is known to be there."""

from importlib.util import find_spec

from process_runtime.main import Invocation, process_main
from process_runtime.settings import Settings
from process_runtime.stop import StopFlag
from protocol.errors import ClusterMclError

_PACKAGES = ("rosbags", "xxhash")


class Ros2NotInstalledError(ClusterMclError):
    """What speaks ROS is an extra, and it is not there."""

    def __init__(self, package: str) -> None:
        self.package, self.extra = package, "ros2"
        super().__init__(f"ROS 2 needs {package!r}: pip install 'clustermcl[{self.extra}]'")


def main() -> None:
    """Run the bridge."""
    process_main(
        "ros2_bridge",
        run_ros2_bridge,
        describe="Stands in for nav2's AMCL on a robot that speaks ROS 2 over rmw_zenoh.",
    )


def run_ros2_bridge(invocation: Invocation) -> None:
    """Be the node until told to stop; as a process of its own."""
    serve(invocation.settings, invocation.process, invocation.stop)


def serve(settings: Settings, process: str, stop: StopFlag) -> None:
    """Be the robot's AMCL until told to stop.

    Raises:
        Ros2NotInstalledError: what speaks ROS is not installed.
        ClusterMclError: as `ros2_bridge.bridge.serve_robot` has it.
    """
    refuse_what_cannot_run(settings)
    from ros2_bridge.bridge import serve_robot  # noqa: PLC0415 - needs the extra

    serve_robot(settings, process, stop)


def refuse_what_cannot_run(settings: Settings) -> None:
    """Say what is wrong before anything is started.

    Raises:
        Ros2NotInstalledError: what speaks ROS is not installed.
        SettingsError: ROS would not take a name.
    """
    for package in _PACKAGES:
        if find_spec(package) is None:
            raise Ros2NotInstalledError(package)
    from ros2_bridge.robot_session import node_name  # noqa: PLC0415 - needs the extra

    node_name(settings.ros2)
