import signal
import time
from itertools import chain, count
from pathlib import Path

import numpy as np
import zenoh

from clustermcl.client import Client
from clustermcl.protocol import keys
from clustermcl.protocol.changes import GONE, Changes
from clustermcl.protocol.codec import encode
from clustermcl.protocol.errors import RefusedError
from clustermcl.protocol.steps import LaserReading, Scan
from clustermcl.recordings.maps.ros_map import save_ros_map
from clustermcl.runtime.settings import Settings, ZenohSettings
from clustermcl.runtime.supervisor import python_module
from tests.integration.conftest import OpenClient, StartProcess
from tests.integration.sensor_bridge.robot import Robot
from tests.integration.waiting import answered, patient_client, wait_until
from tests.unit.changes.drives import OLD, TRUE, path, scan_at
from tests.unit.evaluation.places import belief, place

FLOOD = 2_000


def test_a_bridge_collects_publishes_answers_and_keeps_changes(
    router: ZenohSettings, start_process: StartProcess, open_client: OpenClient, tmp_path: Path
) -> None:
    save_ros_map(OLD, tmp_path / "old.yaml")
    values = (
        f"zenoh.router={router.router}",
        f"bridge.map={tmp_path / 'old.yaml'}",
        f"coordinator.state_folder={tmp_path}",
    )
    command = python_module("clustermcl.sensor_bridge", *chain(*(("--set", v) for v in values)))
    bridge, session = start_process(command), open_client()
    published: list[bytes] = []
    session.declare_subscriber(keys.CHANGES, lambda s: published.append(s.payload.to_bytes()))
    robot = Robot(session, bridge)
    wait_until(lambda: robot.dropped() is not None)
    wait_until(lambda: _are_collected(session))

    stamps_ns = count(0, 10**9)

    def has_become(step: int, scan: Scan) -> bool:
        """Publish a scan, as a laser does again and again; return whether it became a step."""
        robot.publish(
            LaserReading(
                sender="robot", stamp_ns=next(stamps_ns), ranges=scan.ranges,
                angle_min_rad=scan.angle_min_rad, angle_step_rad=scan.angle_step_rad,
                range_max_m=scan.range_max_m, robot_from_laser=scan.robot_from_laser,
                odom_from_robot=scan.odom_from_robot,
            )
        )  # fmt: skip
        return [made.step for made in robot.steps()[-1:]] == [step]

    def drive(first: int, steps: int) -> None:
        """Be the robot, and the coordinator that says where it is."""
        for step, pose in enumerate(path(first, steps), first):
            scan = scan_at(TRUE, pose, step, "")
            wait_until(lambda step=step, scan=scan: has_become(step, scan))
            at = belief(step, "localized", place(1.0, pose))
            robot.put(keys.BELIEF, encode(at))

    drive(0, 45)
    wait_until(lambda: _changes(session).area_m2[GONE] > 0.15, 30.0)
    wait_until(lambda: published)
    asked = [session.get(keys.CHANGES) for _ in range(FLOOD)]
    begun_s = time.monotonic()
    drive(45, 5)  # the flood delays no step much
    assert time.monotonic() - begun_s < 10.0
    assert sum(len(list(replies)) for replies in asked) >= 1
    before = _changes(session)
    bridge.send_signal(signal.SIGTERM)
    bridge.wait()
    start_process(command)
    settings = patient_client(Settings(zenoh=router))
    with Client(settings) as client:
        wait_until(lambda: client.changes().area_m2[GONE] >= before.area_m2[GONE])
        assert np.count_nonzero(client.changes().seen_min()) >= np.count_nonzero(before.seen_min())


def _are_collected(session: zenoh.Session) -> bool:
    try:
        return len(_changes(session).cells.array()) == 0
    except RefusedError:
        return False  # the map is still prepared


def _changes(session: zenoh.Session) -> Changes:
    return answered(session, keys.CHANGES, Changes)
