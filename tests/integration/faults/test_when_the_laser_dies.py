"""docs/failures.md: odometry continues without scans: the pose is dead reckoning and marked so."""

from collections.abc import Iterator
from contextlib import contextmanager

from clustermcl.client import Client
from clustermcl.protocol.answers import PoseAnswer
from clustermcl.protocol.message import Covariance, ellipse_axes
from tests.integration.faults.live_robot import Robot, with_bridge
from tests.integration.faults.system import System
from tests.integration.waiting import wait_until

WORLD = "cross_feature"
"""It has one place that looks like no other."""
FAR_M = 0.8
"""The robot is driven on blindly until this is the standard deviation of the pose."""
UNLIKELY = 25.9
"""Of chi-square with three degrees of freedom, one in a hundred thousand is more."""


@contextmanager
def localized() -> Iterator[tuple[System, Robot, Client]]:
    with with_bridge(WORLD) as tested, tested.client as client:
        robot = Robot(tested.session, WORLD)
        with robot.driving():
            wait_until(lambda: is_well(client.pose()), 120.0)
            yield tested, robot, client


def is_well(pose: PoseAnswer) -> bool:
    return pose.state == "localized" and pose.freshness == "fresh" and pose.workers == 4


def sigma_m(pose: PoseAnswer) -> float:
    assert pose.covariance is not None
    return longest_m(pose.covariance)


def longest_m(covariance: Covariance) -> float:
    return ellipse_axes(covariance[0], covariance[1], covariance[4])[0]


def assert_dead_reckoning_and_honest(client: Client, robot: Robot) -> None:
    """Until the robot is far: dead reckoning, growing covariance, true pose inside it."""
    wait_until(lambda: client.pose().freshness == "dead_reckoning")
    poses: list[PoseAnswer] = []

    def is_far() -> bool:
        poses.append(client.pose())
        return sigma_m(poses[-1]) > FAR_M

    wait_until(is_far, 120.0)
    assert {pose.freshness for pose in poses} == {"dead_reckoning"}
    assert max(pose.age_s for pose in poses) < 5.0, "odometry goes on"
    assert poses[-1].scan_age_s > poses[0].scan_age_s + 2.0
    assert all(robot.surprise(pose) < UNLIKELY for pose in poses[:: len(poses) // 20 + 1])
    answer = client.hypotheses()
    assert longest_m(answer.hypotheses[0].covariance) > FAR_M


def test_the_pose_is_dead_reckoning_while_the_laser_is_dead() -> None:
    with localized() as (_, robot, client):
        assert sigma_m(client.pose()) < 0.5
        robot.has_laser = False
        assert_dead_reckoning_and_honest(client, robot)
        robot.has_laser = True
        wait_until(lambda: client.pose().freshness == "fresh")
        wait_until(lambda: client.pose().scan_age_s < 1.0)
