"""A ROS robot on our real processes during faults, searches and a change of the map."""

import math
from dataclasses import replace

import numpy as np
import pytest

from particle_filter.poses import wrap_angle
from robot_simulator.worlds.catalogue import world
from ros2_bridge import message_types as types
from ros2_bridge.topics import AMCL_POSE
from tests.integration.ros2.robot import planar
from tests.integration.ros2.test_whole_way import WORLD, Drive, put_map, robot_and_system, stamp_of
from tests.integration.waiting import wait_until


@pytest.mark.timeout(400)
def test_a_search_before_the_first_scan_and_a_new_map_under_way_end_at_the_right_place() -> None:
    before = world(WORLD).map
    x, y, heading = before.map_from_grid
    after = replace(before, map_from_grid=(x + 10.0, y - 5.0, heading))
    with robot_and_system() as (tested, robot), tested.client as client:
        robot.call("reinitialize_global_localization", types.EMPTY)
        assert not tested.beliefs
        poses, drive = robot.listen(AMCL_POSE), Drive(robot, tested)

        def is_at(moved_m: tuple[float, float]) -> bool:
            if not poses or stamp_of(poses[-1]) not in drive.truth:
                return False
            truth = drive.truth[stamp_of(poses[-1])]
            told = planar(poses[-1].pose.pose)
            off = np.subtract(told, (truth[0] + moved_m[0], truth[1] + moved_m[1], truth[2]))
            return math.hypot(*off[:2]) < 0.2 and abs(wrap_angle(float(off[2]))) < 0.1

        with drive.driving():
            wait_until(lambda: is_at((0.0, 0.0)), 150.0)
            assert client.status().map_digest == before.digest
            put_map(robot, after)
            wait_until(lambda: client.status().map_digest == after.digest)
            wait_until(lambda: is_at((10.0, -5.0)), 150.0)
        assert client.status().counters["map changed"] == 1
