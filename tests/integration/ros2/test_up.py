import signal
from contextlib import suppress
from pathlib import Path

import pytest

from clustermcl.client import Client
from clustermcl.protocol.errors import ClusterMclError
from clustermcl.recordings.rigid import IDENTITY
from clustermcl.runtime.settings import Settings, ZenohSettings
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.ros2.conftest import OpenRobot, OpenSession
from tests.integration.ros2.test_graph import ENDPOINTS, Graph
from tests.integration.system.commands import SMALL_FILTER, ran, typed
from tests.integration.waiting import wait_until

NAV2 = "amcl:\n  ros__parameters:\n    pf_err: 0.01\n    update_min_d: 0.3\n"


@pytest.mark.usefixtures("router")
def test_up_with_ros2_uses_the_running_router_and_replaces_amcl(
    zenoh_settings: ZenohSettings,
    open_robot: OpenRobot,
    open_robot_session: OpenSession,
    environment: dict[str, str],
    tmp_path: Path,
) -> None:
    graph, robot = Graph(open_robot_session()), open_robot()
    robot.put_mounts(("laser", IDENTITY))
    nav2_params = tmp_path / "nav2_params.yaml"
    nav2_params.write_text(f"{NAV2}    autostart_node: true\n")  # no map is named: ROS has it
    words = [
        "up", "--nav2-params", str(nav2_params), "--set", f"zenoh.router={zenoh_settings.router}",
        "--set", "zenoh.start_router=false", "--set", "worker.count=1",
        *SMALL_FILTER,
    ]  # fmt: skip
    with typed(*words, folder=tmp_path, environment=environment) as up:
        wait_until(lambda: graph.endpoints() == ENDPOINTS)
        modules = {word for process in up.meet_family() for word in process.cmdline()}
        assert "clustermcl.ros2" in modules
        assert "clustermcl.link.router" not in modules
        in_map = world("cross").map
        robot.put_map(in_map)

        def is_in_that_map() -> bool:
            with suppress(ClusterMclError):  # nothing answers yet
                return client.status().map_digest == in_map.digest
            return False

        with Client(Settings(zenoh=zenoh_settings)) as client:
            robot.stand_until(is_in_that_map)
        assert up.end(signal.SIGINT) == 0
        assert up.err.count("pf_err of nav2 has no effect: ") == 1
        assert "Traceback" not in up.err
        up.assert_nothing_runs()


def test_settings_print_a_nav2_file_as_settings_that_can_be_read_again(tmp_path: Path) -> None:
    nav2_params = tmp_path / "nav2_params.yaml"
    nav2_params.write_text(NAV2)
    shown = ran("settings", "--from-nav2", str(nav2_params))
    assert "# pf_err of nav2 has no effect: all places share belief.particles" in shown.stdout
    assert "\ngate_distance_m = 0.3\n" in shown.stdout
    (tmp_path / "settings.toml").write_text(shown.stdout)
    again = ran("settings", "--settings", str(tmp_path / "settings.toml"))
    assert again.stdout == "".join(
        line for line in shown.stdout.splitlines(keepends=True) if "has no effect" not in line
    )
