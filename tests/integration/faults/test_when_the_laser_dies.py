"""docs/failures.md: odometry continues without scans: the pose is dead reckoning and marked so."""

from clustermcl.protocol.answers import PoseAnswer
from clustermcl.protocol.message import Covariance, ellipse_axes
from tests.integration.faults.live_robot import Robot, with_bridge
from tests.integration.waiting import wait_until

WORLD = "cross_feature"
"""It has one place that looks like no other."""
FAR_M = 0.8
"""The robot is driven on blindly until this is the standard deviation of the pose."""
UNLIKELY = 25.9
"""Of chi-square with three degrees of freedom, one in a hundred thousand is more."""


def longest_m(covariance: Covariance) -> float:
    return ellipse_axes(covariance[0], covariance[1], covariance[4])[0]


def test_the_pose_is_dead_reckoning_while_the_laser_is_dead() -> None:
    """Until the robot is far: dead reckoning, growing covariance, true pose inside it."""
    with with_bridge(WORLD) as tested, tested.client as client:
        poses: list[PoseAnswer] = []

        def is_well() -> bool:
            pose = client.pose()
            return (pose.state, pose.freshness, pose.workers) == ("localized", "fresh", 4)

        def sigma_m() -> float:
            poses.append(client.pose())
            assert poses[-1].covariance is not None
            return longest_m(poses[-1].covariance)

        robot = Robot(tested.session, WORLD)
        with robot.driving():
            wait_until(is_well, 120.0)
            assert sigma_m() < 0.5
            robot.has_laser = False
            wait_until(lambda: client.pose().freshness == "dead_reckoning")
            poses.clear()
            wait_until(lambda: sigma_m() > FAR_M, 120.0)
            assert {pose.freshness for pose in poses} == {"dead_reckoning"}
            assert max(pose.age_s for pose in poses) < 5.0, "odometry goes on"
            assert poses[-1].scan_age_s > poses[0].scan_age_s + 2.0
            assert all(robot.surprise(pose) < UNLIKELY for pose in poses[:: len(poses) // 20 + 1])
            assert longest_m(client.hypotheses().hypotheses[0].covariance) > FAR_M
            robot.has_laser = True
            wait_until(lambda: client.pose().freshness == "fresh")
            wait_until(lambda: client.pose().scan_age_s < 1.0)
