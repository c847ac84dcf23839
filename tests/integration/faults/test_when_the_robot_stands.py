"""A standing robot gets places: after its start, after a command, and with a new map."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import zenoh
from msgspec.structs import replace

from clustermcl.client import Client
from clustermcl.commands.stack import COORDINATOR
from clustermcl.link.wire import Publisher
from clustermcl.protocol import keys
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.codec import encode
from clustermcl.protocol.errors import CommandRefusedError
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import LaserReading, OdometryReading
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.runtime.stop import StopFlag
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.faults.system import SMALL, System, system
from tests.integration.running import running
from tests.integration.sensor_bridge.robot import answering
from tests.integration.waiting import wait_until
from tests.integration.worlds import map_reading

LASER_HZ = 10.0


@contextmanager
def standing_robot(session: zenoh.Session, world_name: str) -> Iterator[PoseTuple]:
    """Publishes the same scan ten times a second, and odometry twice as often; yields its pose."""
    tick = next(iter(Simulation(world(world_name), seed=5)))
    odometry = Publisher(session, keys.ODOMETRY_READING)
    laser = Publisher(session, keys.LASER_READING)
    (scan,) = (one for one in tick.readings if isinstance(one, LaserReading))
    here = (0.0, 0.0, 0.0)

    def stand(stop: StopFlag) -> None:
        while not stop.wait(0.5 / LASER_HZ):
            now_ns = time.time_ns()
            odometry.put(OdometryReading(sender="robot", stamp_ns=now_ns, odom_from_robot=here))
            laser.put(replace(scan, stamp_ns=now_ns, odom_from_robot=here))

    with running(stand):
        yield tick.map_from_robot


def may_be_at(belief: Belief, pose: tuple[float, ...]) -> bool:
    return belief.state != "searching" and any(
        np.hypot(*np.subtract(place.pose[:2], pose[:2])) < 0.5 for place in belief.hypotheses
    )


def wait_until_reported(
    tested: System, client: Client, pose: tuple[float, ...], digest: str
) -> None:
    wait_until(lambda: client.status().map_digest == digest)
    wait_until(lambda: tested.beliefs and may_be_at(tested.beliefs[-1], pose))


def test_a_standing_robot_gets_its_possible_places() -> None:
    before, after = world("cross_feature").map, world("cross").map
    bridge = BridgeSettings(map="zenoh", source="zenoh")
    with system(replace(SMALL, bridge=bridge)) as tested, tested.client as client:
        wait_until(lambda: "coordinator ready" in tested.log(COORDINATOR))
        with (
            answering(tested.session, map_reading(before)),
            standing_robot(tested.session, "cross_feature") as pose,
        ):
            wait_until_reported(tested, client, pose, before.digest)
            assert_that_the_scan_of_a_standing_robot_decides_on_a_given_pose(tested, client, pose)
            client.relocalize()
            relocalized = tested.step
            wait_until(lambda: tested.beliefs[-1].state == "searching" or tested.step > relocalized)
            wait_until_reported(tested, client, pose, before.digest)
            tested.session.put(keys.MAP_READING, encode(map_reading(after)))
            wait_until_reported(tested, client, pose, after.digest)
            last_step = tested.step
            assert last_step < 400, "steps of a standing robot end once it is localized"
        status = client.status()
        assert status.counters["map changed"] == 1


def assert_that_the_scan_of_a_standing_robot_decides_on_a_given_pose(
    tested: System, client: Client, pose: PoseTuple
) -> None:
    left, low, _ = world("cross_feature").map.map_from_grid
    for off in ((700.0, 0.5, 1.6), (left - 5.0, low, 0.0)):
        with pytest.raises(CommandRefusedError, match="no free ground"):
            client.set_pose(off)
    x, y, heading = pose
    before = tested.step
    client.set_pose((x, y, heading + math.pi / 2), heading_sigma_rad=0.1)
    wait_until(lambda: any(len(one.hypotheses) > 1 for one in tested.since(before)[1:]))
    given = next(one for one in tested.since(before) if len(one.hypotheses) == 1)
    assert given.hypotheses[0].probability < 0.9
    assert {belief.state for belief in tested.since(before)} <= {"searching", "ambiguous"}
    client.set_pose(pose)
    wait_until(lambda: tested.beliefs[-1].state == "localized")
    assert may_be_at(tested.beliefs[-1], pose)
