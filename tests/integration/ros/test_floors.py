"""A building in ROS: nav2's map_server loads the map of the floor that the robot is on."""

import threading
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no rclpy: see .ci/run")

from nav2_msgs.srv import LoadMap
from nav_msgs.msg import OccupancyGrid
from std_msgs.msg import String

from clustermcl.recordings.maps.map_file import load_map
from clustermcl.recordings.maps.ros_map import save_ros_map
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.ros.conftest import OpenRobot, StartDrive
from tests.integration.ros.robot import LATCHED, WORLD, Robot
from tests.integration.waiting import PATIENCE_S, wait_until


class MapServer:
    """Serves what nav2's map_server does: it reads a map file, publishes it, and answers."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.asked: list[str] = []
        self.may_answer = threading.Event()
        robot.node.create_service(LoadMap, "map_server/load_map", self._on_load)

    @property
    def clients(self) -> int:
        return int(self._robot.node.count_clients("map_server/load_map"))

    def _on_load(self, request: Any, response: Any) -> Any:
        self.asked.append(request.map_url)
        self.may_answer.wait(PATIENCE_S)
        self._robot.put_map(load_map(Path(request.map_url)))
        response.result = LoadMap.Response.RESULT_SUCCESS
        return response


def test_map_server_loads_the_floor_before_a_transform_is_published(
    start_drive: StartDrive, open_robot: OpenRobot, tmp_path: Path
) -> None:
    for floor, name in (("ground", "hall"), ("first", WORLD)):
        save_ros_map(world(name).map, tmp_path / f"{floor}.yaml")
    file = tmp_path / "building.yaml"
    file.write_text("floors: {ground: ground.yaml, first: first.yaml}\n")
    server = MapServer(open_robot(name="map_server"))
    parameters = {"bridge.map": str(file), "ros2.load_floor_maps": True}
    drive = start_drive(parameters=parameters | {"ros2.initial_floor": "first"})
    floors = drive.robot.listen("amcl/floor", String, LATCHED)
    maps = drive.robot.listen("map", OccupancyGrid, LATCHED)
    wait_until(lambda: server.clients)
    [stamp] = drive.drive(1)
    drive.robot.put_initial_pose(drive.truth[stamp])
    drive.drive_until(lambda: server.asked)
    drive.drive(5)
    assert drive.transforms == {}  # navigation still has the map of another floor
    published = len(maps)
    server.may_answer.set()
    wait_until(lambda: len(maps) > published)
    drive.drive_until(lambda: drive.transforms)
    assert server.asked == [str(tmp_path / "first.yaml")]
    assert maps[-1].info.width == world(WORLD).map.cells.shape[1]
    assert [one.data for one in floors] == ["first"]
    drive.drive(5)
    assert drive.error()[0] < 0.2  # in the frame of the floor
