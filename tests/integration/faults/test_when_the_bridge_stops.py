"""docs/failures.md: the bridge or the robot's clock stops, or the bridge has another map."""

import time
from collections.abc import Callable
from pathlib import Path

from msgspec.structs import replace

from clustermcl.link.wire import Publisher
from clustermcl.protocol import keys
from clustermcl.protocol.answers import PoseAnswer
from clustermcl.protocol.job_events import Ended
from clustermcl.protocol.steps import OdometryReading
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.faults.live_robot import BRIDGE, with_live_robot
from tests.integration.faults.system import SMALL, System
from tests.integration.waiting import stretched_s, wait_until
from tests.maps import write_map

STALE_AFTER_S = 1.0
COORDINATOR = replace(SMALL.coordinator, stale_after_s=STALE_AFTER_S)
STALE_SOON = replace(SMALL, coordinator=COORDINATOR)


def poses_until_stale(
    tested: System, publish: Callable[[], None] = lambda: None
) -> list[PoseAnswer]:
    poses: list[PoseAnswer] = []

    def is_stale() -> bool:
        publish()
        poses.append(tested.pose())
        return poses[-1].freshness == "stale"

    wait_until(is_stale)
    return poses


def assert_honest(poses: list[PoseAnswer]) -> None:
    for pose in poses:
        assert (pose.freshness == "stale") == (pose.age_s > STALE_AFTER_S)
        assert pose.pose is not None, "the last pose is still published, with its age"


def test_the_pose_is_stale_while_no_bridge_runs_or_the_clock_stands() -> None:
    with with_live_robot(STALE_SOON) as (tested, robot):
        tested.wait_until_it_tracks()
        clusters = tested.clusters()
        tested.hurt(BRIDGE)
        stopped_s = time.monotonic()
        assert_honest(poses_until_stale(tested))
        assert time.monotonic() - stopped_s < stretched_s(STALE_AFTER_S + 1.0)
        tested.mend()
        wait_until(lambda: tested.pose().freshness == "fresh")
        tested.wait_for_steps(5)
        assert tested.clusters() == clusters

        robot.kill()
        last = tested.pose()
        publisher = Publisher(tested.session, keys.ODOMETRY_READING)
        same = OdometryReading(
            sender="robot", stamp_ns=last.stamp_ns, odom_from_robot=(0.0, 0.0, 0.0)
        )
        poses = poses_until_stale(tested, lambda: publisher.put(same))
        for _ in range(20):
            poses += poses_until_stale(tested, lambda: publisher.put(same))
        assert_honest(poses)
        assert {pose.stamp_ns for pose in poses[-20:]} == {poses[-1].stamp_ns}


def test_a_bridge_restarted_with_another_map_begins_a_new_search_without_any_other_restart() -> (
    None
):
    with with_live_robot() as (tested, _robot), tested.client as client:
        tested.wait_until_it_tracks()
        before = client.status()
        pids = tested.stack.supervisor.pids() | {"workers": tested.worker_pids()}
        map_file = Path(tested.settings.bridge.map)
        write_map(world("cross_feature").map, map_file.parent, map_file.stem)
        tested.restart(BRIDGE)
        wait_until(lambda: client.status().map_digest == load_map(map_file).digest)
        tested.wait_until_it_tracks()
        assert client.status().map_digest != before.map_digest
        assert client.status().counters["map changed"] == 1
        now = tested.stack.supervisor.pids() | {"workers": tested.worker_pids()}
        assert {name for name in now if now[name] != pids[name]} == {BRIDGE}
        ended = [event for event in tested.events() if isinstance(event, Ended)]
        assert [one.cause for one in ended].count("new map") == before.clusters
