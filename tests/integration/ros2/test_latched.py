import numpy as np
import pytest

from clustermcl.filter.arrays import OCCUPIED
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.rigid import flat
from clustermcl.ros2.topics import (
    AMCL_POSE,
    HYPOTHESES,
    HYPOTHESIS_DETECTION,
    PARTICLE_CLOUD,
    STATE,
)
from tests.integration.ros2.conftest import ACTIVE, Active, OpenRobot, OpenSystem, StartBridge
from tests.integration.waiting import wait_until

pytestmark = pytest.mark.usefixtures("router")


def room(width: int = 400, x_m: float = 0.0) -> GridMap:
    cells = np.zeros((300, width), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = OCCUPIED
    return GridMap(cells, 0.05, (x_m, 0.0, 0.0))


def test_a_map_published_before_the_bridge_came_reaches_it_and_each_new_one(
    open_robot: OpenRobot, open_system: OpenSystem, start_bridge: StartBridge
) -> None:
    robot, system = open_robot(), open_system()
    robot.put_map(room())
    start_bridge()
    wait_until(lambda: system.maps)
    cells, cell_m, _ = system.maps[0]
    assert cells.shape == (300, 400)
    assert np.count_nonzero(cells == 100) == np.count_nonzero(cells) == 2 * 400 + 2 * 298
    assert cell_m == 0.05
    assert system.ask_for_map() == system.maps[0][2]  # also a later subscriber
    robot.put_map(room())  # the same: nothing happens
    robot.put_map(room(width=200, x_m=1.0))
    wait_until(lambda: len(system.maps) >= 2)
    assert system.maps[-1][2] == (1.0, 0.0, 0.0)
    assert len(system.maps) == 2


def test_transforms_of_several_nodes_reach_a_bridge_that_comes_later(
    open_robot: OpenRobot, open_system: OpenSystem, start_bridge: StartBridge
) -> None:
    robot, system = open_robot(), open_system()
    robot.put_mounts()
    others = [open_robot(name=f"mount{number}") for number in range(4)]
    for number, other in enumerate(others):
        other.put_mounts((f"laser{number}", flat((0.1 * number, 0.0, 0.0))))
    start_bridge(ACTIVE)
    for number in range(4):
        frame, place_m = f"laser{number}", 0.1 * number

        def is_received(place_m: float = place_m) -> bool:
            return any(laser.robot_from_laser[0] == place_m for laser in system.lasers)

        robot.stand_until(is_received, frame=frame)


def test_a_late_subscriber_gets_the_last_pose_and_places_but_no_old_particles(
    active: Active, open_robot: OpenRobot
) -> None:
    robot, system = active
    robot.stand_until(lambda: system.lasers)
    states = robot.listen(STATE)
    system.believe(system.lasers[-1].stamp_ns, (1, 0.95, (1.0, 2.0, 0.0)), state="localized")
    wait_until(lambda: states)
    late = open_robot(name="rviz")
    received = [late.listen(topic) for topic in (AMCL_POSE, HYPOTHESES, HYPOTHESIS_DETECTION)]
    cloud = late.listen(PARTICLE_CLOUD)
    wait_until(lambda: all(received))
    assert received[0][0].pose.pose.position.y == 2.0
    assert received[2][0].results[0].hypothesis.score == 0.95
    assert cloud == []
