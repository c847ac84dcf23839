import numpy as np
import pytest

from clustermcl.recordings.rigid import IDENTITY
from clustermcl.ros2.topics import AMCL_POSE
from clustermcl.runtime.ros2_settings import Ros2Settings
from tests.integration.ros2.conftest import OpenRobot, OpenSystem, StartBridge
from tests.integration.ros2.robot import planar
from tests.integration.waiting import wait_until

pytestmark = pytest.mark.usefixtures("router")


def settings_of(name: str) -> Ros2Settings:
    """As nav2's launch files name topics in a namespace."""
    return Ros2Settings(
        autostart=True, namespace=f"/{name}", tf_topic="tf", tf_static_topic="tf_static"
    )


def test_two_robots_on_one_router_do_not_mix(
    open_robot: OpenRobot, open_system: OpenSystem, start_bridge: StartBridge
) -> None:
    names = ("robot1", "robot2")
    robots = [open_robot(settings_of(name)) for name in names]
    systems = [open_system(name) for name in names]
    for name, robot in zip(names, robots, strict=True):
        robot.put_mounts(("laser", IDENTITY))
        start_bridge(settings_of(name), robot=name)
    poses = [robot.listen(AMCL_POSE) for robot in robots]
    transforms = [robot.listen(robot.topics.tf) for robot in robots]
    for number, (robot, system) in enumerate(zip(robots, systems, strict=True)):
        robot.stand_until(lambda system=system: system.lasers, (float(number), 0.0, 0.0))  # type: ignore[misc] # as it is now
        place = (10.0 + number, 5.0, 0.0)
        system.believe(system.lasers[-1].stamp_ns, (1, 0.95, place), state="localized")
        wait_until(lambda number=number: poses[number])  # type: ignore[misc] # as it is now
        robot.stand_until(lambda number=number: transforms[number], (float(number), 0.0, 0.0))  # type: ignore[misc] # as it is now
    for number, system in enumerate(systems):
        assert {laser.odom_from_robot for laser in system.lasers} == {(float(number), 0.0, 0.0)}
        reported = [planar(one.pose.pose) for one in poses[number]]
        np.testing.assert_allclose(reported, [(10.0 + number, 5.0, 0.0)])
        moved = [planar(one.transforms[0].transform) for one in transforms[number]]
        np.testing.assert_allclose(moved, [(10.0, 5.0, 0.0)] * len(moved), atol=1e-12)
