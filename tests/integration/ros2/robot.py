"""A robot that speaks ROS 2 over rmw_zenoh: a node made of the bridge's own parts, and listeners.

`tests/unit/ros2` compares its bytes with those of a recorded robot.
"""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import zenoh

from clustermcl.filter.arrays import OCCUPIED
from clustermcl.link.inbox import Inbox
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import LaserReading
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.rigid import IDENTITY, Rigid
from clustermcl.ros2 import message_types as types
from clustermcl.ros2.message_types import decode, encode, new, request_of, response_of, type_hash
from clustermcl.ros2.messages_out import header, pose, pose_stamped, transform
from clustermcl.ros2.node import FromRos, RosNode, RosPublisher
from clustermcl.ros2.topics import INITIAL_POSE, Topic, Topics
from clustermcl.ros2.wire import NodeName, attachment, data_key
from clustermcl.runtime.ros2_settings import Ros2Settings
from tests.integration.waiting import PATIENCE_S, wait_until

SCAN = LaserReading(
    sender="test",
    stamp_ns=0,
    ranges=ArrayBlob.of(np.linspace(1.0, 3.0, 9), "float32"),
    angle_min_rad=-1.0,
    angle_step_rad=0.25,
    range_max_m=10.0,
    robot_from_laser=(0.0, 0.0, 0.0),
)


class RosRobot:
    """A node `/robot` of a domain: it publishes what a robot does, listens, and calls services."""

    def __init__(
        self,
        session: zenoh.Session,
        settings: Ros2Settings,
        name: str = "robot",
        *,
        humble: bool = False,
    ) -> None:
        self._session, self._humble = session, humble
        self.name = NodeName(settings.domain_id, settings.namespace, name)
        self.node = RosNode(session, self.name, humble=humble)
        self.topics = Topics(settings)
        self.received: dict[str, list[Any]] = {}
        self.received_at_s: dict[str, list[float]] = {}
        self._publishers: dict[str, RosPublisher] = {}
        self._sequence = 0

    def put(self, topic: Topic, message: Any) -> None:
        """Publish; the publisher is declared with the first message."""
        if topic.name not in self._publishers:
            self._publishers[topic.name] = self.node.publisher(topic)
        self._publishers[topic.name].put(message)

    def listen(self, topic: Topic) -> list[Any]:
        """A growing list of a topic's messages from now on, and the latched one."""
        received: list[Any] = self.received.setdefault(topic.name, [])
        at_s = self.received_at_s.setdefault(topic.name, [])

        class _List(Inbox[Any]):
            def put_newest(self, _kind: str, state: Any) -> None:
                assert isinstance(state, FromRos)
                assert not state.problem
                at_s.append(time.monotonic())
                received.append(decode(state.payload, topic.ros_type))

        reported = replace(topic, name=topic.name.replace("~/", "amcl/"))
        self.node.subscribe(reported, _List({topic.name: 1}))
        return received

    def call(
        self, service: str, ros_type: str, request: Any = None, *, deadline_s: float = PATIENCE_S
    ) -> Any:
        """Call a service, as a client of ROS that waits until the service is there."""
        self._sequence += 1
        client = bytes(16)
        name = self.name.topic(service)
        hashed = type_hash(ros_type, humble=self._humble)
        key = data_key(self.name.domain_id, name, ros_type, hashed)
        payload = encode(request or new(request_of(ros_type)), request_of(ros_type))
        answers: list[zenoh.Sample] = []

        def is_answered() -> bool:
            replies = self._session.get(
                key,
                payload=payload,
                attachment=attachment(self._sequence, time.time_ns(), client),
                target=zenoh.QueryTarget.ALL_COMPLETE,
                timeout=2.0,
            )
            answers.extend(reply.ok for reply in replies if reply.ok is not None)
            return bool(answers)

        wait_until(is_answered, deadline_s)
        assert answers[0].attachment is not None
        assert answers[0].attachment.to_bytes()[:8] == self._sequence.to_bytes(8, "little")
        return decode(answers[0].payload.to_bytes(), response_of(ros_type))

    # --- what a robot says

    def put_map(self, grid_map: GridMap) -> None:
        rows, cols = grid_map.cells.shape
        info = new(
            "nav_msgs/msg/MapMetaData",
            resolution=grid_map.cell_m,
            width=cols,
            height=rows,
            origin=pose(grid_map.map_from_grid),
        )
        cells = np.where(grid_map.cells == OCCUPIED, np.int8(100), grid_map.cells).ravel()
        message = new(types.OCCUPANCY_GRID, header=header(0, "map"), info=info, data=cells)
        self.put(self.topics.map, message)

    def put_odometry(self, stamp_ns: int, pose: PoseTuple) -> None:
        self.put(self.topics.tf, transform(pose, stamp_ns, "odom", "base_footprint"))

    def put_mounts(self, *mounts: tuple[str, Rigid]) -> None:
        """Where lasers are on the robot, latched."""
        links = [link("base_footprint", "base_link", IDENTITY)]
        links += [link("base_link", frame, mount) for frame, mount in mounts]
        self.put(self.topics.tf_static, new(types.TF_MESSAGE, transforms=links))

    def put_scan(self, reading: LaserReading, frame: str = "laser", *, stamp_ns: int) -> None:
        self.put(self.topics.scans[0], laser_scan(reading, frame, stamp_ns))

    def stand_until(
        self,
        condition: Callable[[], object],
        odometry: PoseTuple = (0.0, 0.0, 0.0),
        *,
        frame: str = "laser",
        deadline_s: float = PATIENCE_S,
    ) -> None:
        """Publish odometry and scans of a standing robot until a condition holds."""

        def output() -> object:
            stamp_ns = time.time_ns()
            self.put_odometry(stamp_ns, odometry)
            self.put_scan(SCAN, frame, stamp_ns=stamp_ns)
            return condition()

        wait_until(output, deadline_s)

    def put_initial_pose(
        self, pose: PoseTuple, *, sigma: float = 0.3, stamp_ns: int = 0, frame: str = "map"
    ) -> None:
        variance = sigma * sigma
        covariance = (variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance / 4.0)
        self.put(INITIAL_POSE, pose_stamped(pose, covariance, stamp_ns, frame))


def link(parent: str, child: str, at: Rigid) -> Any:
    made = new(
        "geometry_msgs/msg/Transform",
        translation=new("geometry_msgs/msg/Vector3", x=at.x, y=at.y, z=at.z),
        rotation=new("geometry_msgs/msg/Quaternion", x=at.qx, y=at.qy, z=at.qz, w=at.qw),
    )
    return new(
        "geometry_msgs/msg/TransformStamped",
        header=header(0, parent),
        child_frame_id=child,
        transform=made,
    )


def laser_scan(reading: LaserReading, frame: str, stamp_ns: int) -> Any:
    """A reading as the `sensor_msgs/LaserScan` that it could have been."""
    ranges = np.array(reading.ranges.array(), np.float32)
    return new(
        types.LASER_SCAN,
        header=header(stamp_ns, frame),
        angle_min=reading.angle_min_rad,
        angle_max=reading.angle_min_rad + reading.angle_step_rad * (len(ranges) - 1),
        angle_increment=reading.angle_step_rad,
        scan_time=0.1,
        range_min=0.02,
        range_max=reading.range_max_m,
        ranges=ranges,
    )


def planar(pose: Any) -> PoseTuple:
    """A `geometry_msgs/Pose` or `Transform` seen from above."""
    at = pose.position if hasattr(pose, "position") else pose.translation
    turn = pose.orientation if hasattr(pose, "orientation") else pose.rotation
    return at.x, at.y, 2.0 * math.atan2(turn.z, turn.w)
