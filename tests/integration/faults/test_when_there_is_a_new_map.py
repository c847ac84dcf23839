"""docs/operations.md: a new map means a restart of the bridge and a new search."""

from pathlib import Path

import numpy as np

from grid_maps.ros_map import write_map
from protocol.answers import PoseAnswer
from protocol.job_events import Ended
from recordings.map_file import load_map
from robot_simulator.worlds.catalogue import world
from tests.integration.faults.live_robot import BRIDGE, Robot, with_bridge
from tests.integration.waiting import wait_until

BEFORE, AFTER = "cross", "cross_feature"


def test_a_bridge_restarted_with_another_map_is_followed_without_any_other_restart() -> None:
    with with_bridge(BEFORE) as tested, tested.client as client:
        with Robot(tested.session, BEFORE).driving():
            tested.wait_until_it_tracks()
        before, pids = client.status(), tested.stack.pids() | {"workers": tested.worker_pids()}
        map_file = Path(tested.settings.bridge.map)
        write_map(world(AFTER).map, map_file.parent, map_file.stem)
        tested.restart(BRIDGE)
        robot = Robot(tested.session, AFTER)
        with robot.driving():
            wait_until(lambda: client.status().map_digest == load_map(map_file).digest)
            poses: list[PoseAnswer] = []

            def is_localized() -> bool:
                poses.append(client.pose())
                return poses[-1].state == "localized" and poses[-1].freshness == "fresh"

            wait_until(is_localized, 120.0)
            assert np.hypot(*robot.error(poses[-1])[:2]) < 0.5
        after = client.status()
        assert after.map_digest != before.map_digest
        assert after.counters["map changed"] == 1
        now = tested.stack.pids() | {"workers": tested.worker_pids()}
        assert {name for name in now if now[name] != pids[name]} == {BRIDGE}
        ended = [e.event for e in client.events().events if isinstance(e.event, Ended)]
        assert [one.cause for one in ended].count("new map") == before.clusters
