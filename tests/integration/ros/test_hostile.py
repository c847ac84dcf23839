"""Messages of random bytes, which rclpy itself deserialises in the node's process."""

import random
import struct
from typing import Any

import psutil
import pytest

pytest.importorskip("rclpy", reason="no rclpy: see .ci/run")

from apriltag_msgs.msg import AprilTagDetectionArray
from nav_msgs.msg import OccupancyGrid
from rclpy.serialization import serialize_message
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

from tests.integration.ros.conftest import OpenRobot, StartDrive
from tests.integration.ros.robot import LATCHED, SENSOR, Robot, link, pose_message
from tests.integration.waiting import wait_until

READ = {
    "scan": (LaserScan(ranges=[1.0] * 60), SENSOR),
    "tf": (TFMessage(transforms=[link("odom", "base_footprint", (0.0, 0.0, 0.0), 0)]), 100),
    "tf_static": (TFMessage(transforms=[link("a", "b", (0.0, 0.0, 0.0), 0)]), LATCHED),
    "initialpose": (pose_message((0.0, 0.0, 0.0)), 10),
    "map": (OccupancyGrid(data=[0] * 64), LATCHED),
    "tags": (AprilTagDetectionArray(), SENSOR),
    "poses": (pose_message((0.0, 0.0, 0.0)), 10),
}
PARAMETERS = {"ros2.tag_topics": "tags", "ros2.pose_topics": "poses"}
GROWTH_MB = 150.0


def mutated(rng: random.Random, data: bytes) -> bytes:
    """Random bytes, or a message that is cut, has flipped bits, or a huge length or number."""
    header, body = data[:4], bytearray(data[4:])
    match rng.randrange(5):
        case 0:
            return rng.randbytes(rng.randrange(300))
        case 1:
            return header + rng.randbytes(rng.randrange(300))
        case 2:
            return header + bytes(body[: rng.randrange(len(body) + 1)])
        case 3:
            for _ in range(rng.randrange(1, 20)):
                body[rng.randrange(len(body))] ^= 1 << rng.randrange(8)
        case _:
            at = rng.randrange(max(len(body) // 4, 1)) * 4
            huge = rng.choice([0xFFFFFFFF, 0x7FFFFFFF, 0x7F800000, 0x7FC00000, 1 << 20])
            body[at : at + 4] = struct.pack("<I", huge)
    return header + bytes(body)


def attack(robot: Robot, count: int) -> None:
    rng = random.Random(5)
    valid = {topic: bytes(serialize_message(message)) for topic, (message, _) in READ.items()}
    publishers: dict[str, Any] = {
        topic: robot.publisher(topic, type(message), qos) for topic, (message, qos) in READ.items()
    }
    for topic in READ:
        wait_until(lambda topic=topic: robot.node.count_subscribers(topic))
    for _ in range(count):
        topic = rng.choice(list(READ))
        publishers[topic].publish(mutated(rng, valid[topic]))


@pytest.mark.parametrize(
    "count", [5_000, pytest.param(100_000, marks=[pytest.mark.soak, pytest.mark.timeout(1800)])]
)
def test_the_node_outlives_random_bytes(
    start_drive: StartDrive, open_robot: OpenRobot, count: int
) -> None:
    drive = start_drive(parameters=PARAMETERS, zero_ns=2_000_000_000 * 10**9)
    memory = psutil.Process(drive.node.pid).memory_info
    before = memory().rss
    attack(open_robot(name="attacker"), count)
    assert drive.robot.state() == "active"  # all has been read, or was dropped
    drive.begin()
    drive.localize()
    assert drive.node.is_running()
    assert "Traceback" not in drive.node.err
    assert (memory().rss - before) / 1e6 < GROWTH_MB
