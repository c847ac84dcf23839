"""docs/failures.md: bridge or clock stops, its map is another one, its scans are forged."""

import os
import signal
import time
from collections.abc import Callable
from itertools import cycle
from pathlib import Path

import zenoh
from msgspec.structs import replace

from clustermcl.commands.stack import COORDINATOR, WORKERS
from clustermcl.link.wire import Publisher
from clustermcl.protocol import keys
from clustermcl.protocol.answers import PoseAnswer
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.job_events import Ended
from clustermcl.protocol.message import MAX_SCAN_STEP
from clustermcl.protocol.steps import OdometryReading, Scan
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.recordings.maps.map_message import to_message
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.faults.live_robot import BRIDGE, assert_same_as_alone, with_live_robot
from tests.integration.faults.system import SIMULATOR, SMALL, System, system
from tests.integration.waiting import stretched_s, wait_until
from tests.integration.worlds import world_of
from tests.maps import write_map

STALE_AFTER_S = 1.0
STALE_SOON = replace(SMALL, coordinator=replace(SMALL.coordinator, stale_after_s=STALE_AFTER_S))


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


HIGHEST = 2**53 - 1
BURST = 4


def forge(tested: System, first_step: int, count: int) -> None:
    scan = tested.next_message(keys.SCAN, Scan)
    for n in range(count):
        forged = replace(scan, step=first_step + n, stamp_ns=scan.stamp_ns + n * 1_000_000)
        block = zenoh.CongestionControl.BLOCK
        tested.session.put(keys.SCAN, encode(forged), congestion_control=block)


def test_single_scans_far_ahead_change_no_belief_and_after_a_burst_a_restart_localizes_again() -> (
    None
):
    with with_live_robot() as (tested, _robot), tested.client as client:
        tested.wait_until_it_tracks()
        for step, cause in ((HIGHEST, "malformed Scan: field"), (10**9, "scan far ahead")):
            forge(tested, step, 1)
            tested.wait_for_steps(5)
            wait_until(lambda cause=cause: client.status().counters.get(cause) == 1)
        assert client.status().counters.get("steps restarted", 0) == 0
        assert_same_as_alone(tested)

        for restarted in (BRIDGE, COORDINATOR):
            forge(tested, MAX_SCAN_STEP - BURST, BURST)
            wait_until(lambda: tested.step >= MAX_SCAN_STEP - BURST)
            tested.restart(restarted)
            wait_until(lambda: tested.tracks() and numbers_steps_from_0(tested))
            wait_until(lambda: client.pose().freshness == "fresh")


def numbers_steps_from_0(tested: System) -> bool:
    return max(belief.step for belief in tested.beliefs[-20:]) < MAX_SCAN_STEP // 2


def repeat_every_scan(tested: System, ours: str, theirs: str) -> None:
    """Publish each scan of the bridge again, as of bridges that have other maps.

    There are two such maps in turn: a busy machine may deliver three copies in a row, and three
    scans of one other map mean that the bridge has changed its map.
    """
    publisher, others = Publisher(tested.session, keys.SCAN), cycle([theirs, theirs[::-1]])

    def on_scan(sample: zenoh.Sample) -> None:
        scan = decode(sample.payload.to_bytes(), Scan)
        if scan.map_digest == ours:
            publisher.put(replace(scan, map_digest=next(others)))

    tested.session.declare_subscriber(keys.SCAN, on_scan)


def test_scans_and_orders_of_another_map_are_refused(tmp_path: Path) -> None:
    ours = world_of(SMALL).map.digest
    other = load_map(write_map(world("office").map, tmp_path, "other"))
    theirs = other.digest
    both = f"has map {theirs[:12]}, expected {ours[:12]}"
    with system() as tested, tested.client as client:
        tested.wait_until_it_tracks()
        clusters = tested.clusters()
        repeat_every_scan(tested, ours, theirs)
        wait_until(lambda: client.status().counters.get("scan of another map", 0) > 10)
        assert client.status().map_digest == ours
        assert tested.clusters() == clusters, "they change nothing"
        # Another answers for the bridge; the supervisor does not look meanwhile. A worker that
        # starts now is offered the other map, and does not take it.
        tested.hurt(SIMULATOR)

        def answer(query: zenoh.Query) -> None:
            with query:
                query.reply(keys.MAP, encode(to_message(other, "bridge")))

        tested.session.declare_queryable(keys.MAP, answer, complete=True)
        os.kill(tested.worker_pids()[0], signal.SIGKILL)
        wait_until(lambda: both in tested.log(WORKERS))
        wait_until(lambda: client.status().counters.get("order refused", 0) > 0)
        assert client.status().map_digest == ours
