"""docs/failures.md: the bridge or the robot's clock stops: the pose has an age and is stale."""

import time

from msgspec.structs import replace

from protocol import keys
from protocol.answers import PoseAnswer
from protocol.steps import OdometryReading
from tests.integration.faults.live_robot import BRIDGE, with_live_robot
from tests.integration.faults.system import SMALL, System
from tests.integration.waiting import stretched_s, wait_until
from zenoh_link.wire import Publisher

STALE_AFTER_S = 1.0
COORDINATOR = replace(SMALL.coordinator, stale_after_s=STALE_AFTER_S)
STALE_SOON = replace(SMALL, coordinator=COORDINATOR)


def poses_until_stale(tested: System) -> list[PoseAnswer]:
    """Collect answers from now on until one is stale."""
    poses: list[PoseAnswer] = []

    def is_stale() -> bool:
        with tested.client as client:
            poses.append(client.pose())
        return poses[-1].freshness == "stale"

    wait_until(is_stale)
    return poses


def assert_honest(poses: list[PoseAnswer]) -> None:
    for pose in poses:
        assert (pose.freshness == "stale") == (pose.age_s > STALE_AFTER_S)
        assert pose.map_from_robot is not None, "the last pose is still told, with its age"


def is_fresh(tested: System) -> bool:
    with tested.client as client:
        return client.pose().freshness == "fresh"


def test_a_killed_bridge_makes_the_pose_stale_until_the_next_bridge_publishes() -> None:
    with with_live_robot(STALE_SOON) as (tested, _):
        tested.wait_until_it_tracks()
        clusters = tested.clusters()
        tested.hurt(BRIDGE)
        stopped_s = time.monotonic()
        poses = poses_until_stale(tested)
        assert time.monotonic() - stopped_s < stretched_s(STALE_AFTER_S + 1.0)
        assert_honest(poses)
        tested.mend()
        wait_until(lambda: is_fresh(tested))
        tested.wait_for_steps(5)
        assert tested.clusters() == clusters


def test_a_clock_that_stands_makes_the_pose_stale_however_much_is_published() -> None:
    with with_live_robot(STALE_SOON) as (tested, robot):
        tested.wait_until_it_tracks()
        robot.kill()
        with tested.client as client:
            last = client.pose()
        reading = OdometryReading(
            sender="robot", stamp_ns=last.stamp_ns, odom_from_robot=(0.0, 0.0, 0.0)
        )
        publisher = Publisher(tested.session, keys.ODOMETRY_READING)
        poses: list[PoseAnswer] = []

        def is_stale() -> bool:
            publisher.put(reading)
            with tested.client as client:
                poses.append(client.pose())
            return poses[-1].freshness == "stale"

        wait_until(is_stale)
        assert_honest(poses)
        for _ in range(20):
            assert is_stale()
        assert {pose.stamp_ns for pose in poses[-20:]} == {poses[-1].stamp_ns}
