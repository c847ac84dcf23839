import math
import time
from typing import Any

import msgspec
import pytest
import zenoh

from protocol.arrays import ArrayBlob
from recordings.rigid import IDENTITY
from ros2_bridge import message_types as types
from ros2_bridge.message_types import encode, new, type_hash
from ros2_bridge.messages_out import transform
from ros2_bridge.topics import DIAGNOSTICS, ROSOUT, Topic
from ros2_bridge.wire import attachment, data_key, dds_type
from tests.integration.ros2.conftest import ACTIVE, OpenRobot, OpenSession, OpenSystem, StartBridge
from tests.integration.ros2.robot import SCAN, RosRobot
from tests.integration.waiting import wait_until

pytestmark = pytest.mark.usefixtures("router")


def put_bytes(
    session: zenoh.Session, topic: Topic, payload: bytes, attached: bytes | None = None
) -> None:
    """Publish whatever on a topic's key."""
    hashed = type_hash(topic.ros_type, humble=False)
    key = data_key(0, topic.name, dds_type(topic.ros_type), hashed)
    beside = attachment(1, time.time_ns(), bytes(16)) if attached is None else attached
    session.put(key, payload, attachment=beside)


def publish_all_that_is_wrong(robot: RosRobot, foreign: zenoh.Session) -> None:
    now_ns, names = time.time_ns(), robot.topics
    robot.put_odometry(now_ns, (0.0, 0.0, 0.0))
    robot.put_scan(SCAN, "mast", stamp_ns=now_ns)
    no_ranges = msgspec.structs.replace(SCAN, ranges=ArrayBlob.of([math.nan] * 9, "float32"))  # type: ignore[arg-type] # a list will do
    robot.put_scan(no_ranges, stamp_ns=now_ns)
    robot.put(names.tf, transform((math.nan, 0.0, 0.0), now_ns, "odom", "base_footprint"))
    robot.put(names.tf, transform((1.0, 0.0, 0.0), now_ns, "map", "odom"))
    robot.put(names.tf, transform((1.0, 0.0, 0.0), now_ns, "hen", "egg"))
    robot.put(names.tf, transform((1.0, 0.0, 0.0), now_ns, "egg", "hen"))
    robot.put_scan(SCAN, "egg", stamp_ns=now_ns)
    robot.put(names.map, new(types.OCCUPANCY_GRID))  # 0 x 0
    robot.put_initial_pose((0.0, 0.0, 0.0), frame="odom")
    robot.put_initial_pose((math.nan, 0.0, 0.0))
    scan = encode(new(types.LASER_SCAN), types.LASER_SCAN)
    put_bytes(foreign, names.scans[0], scan, bytes(32))
    put_bytes(foreign, names.scans[0], b"\0\3\0\0" + scan[4:])  # another encoding
    put_bytes(foreign, names.scans[0], scan[: len(scan) // 2])
    put_bytes(foreign, names.tf, b"")


EXPECTED = {
    "laser scan without transform: frames not connected",
    "laser scan without transform: tf loops",
    "laser scan refused",
    "transform refused",
    "map to odom from another node",
    "map refused",
    "map of another frame",
    "initial pose refused",
    "not a ROS message",
    "malformed LaserScan: not CDR",
    "malformed TFMessage: not CDR",
}


def test_each_kind_of_bad_input_is_counted_and_logged_once(
    open_robot: OpenRobot,
    open_robot_session: OpenSession,
    open_system: OpenSystem,
    start_bridge: StartBridge,
) -> None:
    robot, system, foreign = open_robot(), open_system(), open_robot_session()
    robot.put_mounts(("laser", IDENTITY))
    bridge = start_bridge(ACTIVE)
    diagnostics, logged = robot.listen(DIAGNOSTICS), robot.listen(ROSOUT)
    robot.stand_until(lambda: system.lasers)
    started_s = time.monotonic()
    for _ in range(3):
        publish_all_that_is_wrong(robot, foreign)

    def counted() -> dict[str, int]:
        values: list[Any] = diagnostics[-1].status[0].values if diagnostics else []
        return {one.key: int(one.value) for one in values if one.key in EXPECTED}

    wait_until(lambda: set(counted()) == EXPECTED)
    wait_until(lambda: counted()["laser scan without transform: frames not connected"] == 3)
    for cause in ("malformed LaserScan: not CDR", "initial pose refused"):
        wait_until(lambda cause=cause: counted()[cause] == 6)  # type: ignore[misc] # as it is now
    minutes = (time.monotonic() - started_s) / 60.0
    for cause in EXPECTED:
        lines = [line for line in bridge.err.splitlines() if f": {cause}" in line]
        assert 1 <= len(lines) <= 1 + minutes, cause
    assert "laser 'mast', waited for " in bridge.err
    expected = {(30, "amcl", cause) for cause in EXPECTED if ":" not in cause}
    expected.add((20, "amcl", "/amcl is running in ROS domain 0"))  # before it was listened to
    wait_until(
        lambda: (
            expected <= {(one.level, one.name, one.msg.partition(":")[0]) for one in list(logged)}
        )
    )
    assert "tf loops: " in bridge.err
    assert "an attachment of 32 bytes, not 33" in bridge.err
    before = len(system.lasers)
    robot.stand_until(lambda: len(system.lasers) > before)
    assert bridge.is_running()
    assert system.commands == []


def test_a_malformed_service_call_gets_no_answer_and_the_next_one_does(
    open_robot: OpenRobot, open_robot_session: OpenSession, start_bridge: StartBridge
) -> None:
    robot, foreign = open_robot(), open_robot_session()
    robot.put_mounts()
    start_bridge(ACTIVE)
    kind = types.SET_PARAMETERS
    key = data_key(0, "/amcl/set_parameters", dds_type(kind), type_hash(kind, humble=False))
    good = attachment(1, time.time_ns(), bytes(16))
    for payload, attached in ((b"\xff" * 9, good), (b"", good), (b"\0\1\0\0\0\0\0\0", b"short")):
        replies = foreign.get(key, payload=payload, attachment=attached, timeout=1.0)
        assert [reply.ok for reply in replies] == []
    assert robot.call("/amcl/set_parameters", kind).results == []
