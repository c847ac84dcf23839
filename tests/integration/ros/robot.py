"""A robot of rclpy's nodes: what it publishes, and what it hears of AMCL's node."""

import math
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="no rclpy: see .ci/run")

from bond.msg import Status
from clustermcl_ros import messages
from geometry_msgs.msg import PoseWithCovarianceStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import OccupancyGrid
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter as Value
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from clustermcl.filter.arrays import OCCUPIED
from clustermcl.filter.poses import wrap_angle
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import LaserReading, OdometryReading
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.ros2 import message_types, messages_out
from clustermcl.simulator.sensors import LidarModel
from clustermcl.simulator.simulation import Simulation, Tick
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.processes import RunningProcess
from tests.integration.waiting import PATIENCE_S, wait_until

message_types.use(messages.new)

WORLD, SEED = "cross_feature", 3
CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = 1, 2, 3, 4
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SENSOR = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
_STAMP_NS = 1_700_000_000 * 10**9
_ANSWERED_WITHIN_S, _REPEATED_S = 0.5, 15.0


class Robot:
    """Nodes of a robot in one domain; a thread delivers what they receive."""

    def __init__(self, domain: int, namespace: str = "", name: str = "robot") -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node(name, namespace=namespace, context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except Exception:  # rclpy raises whatever the end of its context breaks
            if self.context.ok():
                raise

    def close(self) -> None:
        rclpy.try_shutdown(context=self.context)
        self._thread.join(PATIENCE_S)

    # --- the graph

    def publisher(self, topic: str, kind: Any, qos: QoSProfile | int = 10) -> Any:
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(kind, topic, qos)
        return self._publishers[topic]

    def put(self, topic: str, message: Any, qos: QoSProfile | int = 10) -> None:
        self.publisher(topic, type(message), qos).publish(message)

    def listen(self, topic: str, kind: Any, qos: QoSProfile | int = 100) -> list[Any]:
        """A growing list of a topic's messages from now on, and of the latched one."""
        received: list[Any] = []
        self.node.create_subscription(kind, topic, received.append, qos)
        return received

    def call(self, service: str, kind: Any, **fields: Any) -> Any:
        """Call a service once it is there; return its response.

        The request is repeated: a killed process stays in the graph for a while, and gets one.
        """
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, service)
        client = self._clients[service]
        wait_until(client.service_is_ready)
        for _ in range(round(PATIENCE_S / _REPEATED_S)):
            future = client.call_async(kind.Request(**fields))
            until_s = time.monotonic() + _REPEATED_S
            wait_until(lambda: future.done() or time.monotonic() > until_s)  # noqa: B023 - waits here
            if future.done():
                return future.result()
        pytest.fail(f"{service} does not answer")

    # --- AMCL's lifecycle and parameters

    def change_state(self, transition: int) -> bool:
        asked = Transition(id=transition)
        return bool(self.call("amcl/change_state", ChangeState, transition=asked).success)

    def state(self) -> str:
        return str(self.call("amcl/get_state", GetState).current_state.label)

    def activate(self) -> None:
        assert self.change_state(CONFIGURE)
        assert self.change_state(ACTIVATE)

    def set_parameters(self, **values: Any) -> list[Any]:
        asked = [Value(name, value=value).to_parameter_msg() for name, value in values.items()]
        return list(self.call("amcl/set_parameters", SetParameters, parameters=asked).results)

    def parameters(self, *names: str) -> list[Any]:
        response = self.call("amcl/get_parameters", GetParameters, names=names)
        return [parameter_value_to_python(one) for one in response.values]

    # --- what a robot publishes

    def put_map(self, grid_map: GridMap) -> None:
        message = OccupancyGrid()
        message.header.frame_id = "map"
        message.info.height, message.info.width = grid_map.cells.shape
        message.info.resolution = grid_map.cell_m
        message.info.origin = messages_out.pose(grid_map.map_from_grid)
        cells = np.where(grid_map.cells == OCCUPIED, 100, grid_map.cells).astype(np.int8)
        message.data.frombytes(cells.tobytes())
        self.put("map", message, LATCHED)

    def put_mount(self, mount: PoseTuple) -> None:
        """Where the laser is on the robot, latched."""
        mounted = TFMessage(transforms=[link("base_footprint", "laser", mount, 0)])
        self.put("tf_static", mounted, LATCHED)

    def put_odometry(self, reading: OdometryReading, zero_ns: int) -> None:
        one = link("odom", "base_footprint", reading.odom_from_robot, zero_ns + reading.stamp_ns)
        self.put("tf", TFMessage(transforms=[one]), 100)

    def put_scan(self, reading: LaserReading, zero_ns: int) -> None:
        message = LaserScan()
        message.header.stamp = time_of(zero_ns + reading.stamp_ns)
        message.header.frame_id = "laser"
        ranges = np.asarray(reading.ranges.array(), np.float32)
        message.angle_min = reading.angle_min_rad
        message.angle_increment = reading.angle_step_rad
        message.angle_max = reading.angle_min_rad + reading.angle_step_rad * (len(ranges) - 1)
        message.range_min, message.range_max = 0.0, reading.range_max_m
        message.ranges = ranges.tolist()
        self.put("scan", message, SENSOR)

    def put_initial_pose(self, pose: PoseTuple) -> None:
        self.put("initialpose", pose_message(pose))


class Drive:
    """A simulated robot; each scan waits for its transform from `map` to `odom`, for a while.

    `clocked`: the robot publishes /clock.
    """

    def __init__(
        self,
        robot: Robot,
        node: RunningProcess,
        *,
        start: PoseTuple | None = None,
        zero_ns: int = _STAMP_NS,
        clocked: bool = False,
    ) -> None:
        self.robot, self.node, self.zero_ns, self._clocked = robot, node, zero_ns, clocked
        self.simulation = Simulation(world(WORLD), SEED, start=start)
        self.poses = robot.listen("amcl_pose", PoseWithCovarianceStamped, LATCHED)
        self.states = robot.listen("amcl/state", String, LATCHED)
        self.truth: dict[int, PoseTuple] = {}
        self.transforms: dict[int, tuple[float, Any]] = {}
        """When the transform from `map` to `odom` came, and it, by the stamp of its scan."""
        robot.node.create_subscription(TFMessage, "tf", self._on_tf, 100)

    def _on_tf(self, message: Any) -> None:
        for one in message.transforms:
            if one.header.frame_id == "map":
                stamp_ns = ns_of(one.header.stamp) - 10**9  # transform_tolerance
                self.transforms.setdefault(stamp_ns, (time.monotonic(), one))

    def begin(self) -> None:
        """Publish the map and where the laser is; wait until AMCL's node reads scans."""
        self.robot.put_map(world(WORLD).map)
        self.robot.put_mount(LidarModel().robot_from_laser)
        node = self.robot.node
        wait_until(lambda: node.count_subscribers("scan") and node.count_publishers("tf"))

    def localize(self) -> None:
        """Give the robot its pose, and drive until the node has published one."""
        [stamp] = self.drive(1)
        self.robot.put_initial_pose(self.truth[stamp])
        self.drive_until(lambda: self.poses)
        self.drive(5)

    def ticks(self, count: int, *, within_s: float = _ANSWERED_WITHIN_S) -> Iterator[Tick]:
        """Drive; after each scan wait at most this long for its transform."""
        for tick, _ in zip(self.simulation, range(count), strict=False):
            self.step(tick, within_s)
            yield tick

    def drive(self, count: int, *, within_s: float = _ANSWERED_WITHIN_S) -> list[int]:
        """Drive; return the stamps of the scans."""
        return [self.zero_ns + tick.laser.stamp_ns for tick in self.ticks(count, within_s=within_s)]

    def drive_until(self, condition: Callable[[], object], at_most: int = 5000) -> None:
        for _ in self.ticks(at_most, within_s=0.03):
            if condition():
                return
        pytest.fail(f"{condition} did not hold within {at_most} scans")

    def step(self, tick: Tick, within_s: float) -> None:
        before, after = tick.odometry
        stamp_ns = self.zero_ns + tick.laser.stamp_ns
        self.truth[stamp_ns] = tick.map_from_robot
        if self._clocked:
            self.robot.put("/clock", Clock(clock=time_of(stamp_ns)), 1)
        self.robot.put_odometry(before, self.zero_ns)
        self.robot.put_odometry(after, self.zero_ns)
        self.robot.put_scan(tick.laser, self.zero_ns)
        until_s, nap = time.monotonic() + within_s, threading.Event()
        while stamp_ns not in self.transforms and time.monotonic() < until_s:
            nap.wait(0.001)

    @property
    def posed_ns(self) -> int:
        """Stamp of the last `amcl_pose`."""
        return ns_of(self.poses[-1].header.stamp)

    def error(self, number: int = -1) -> tuple[float, float]:
        """Distance [m] and angle [rad] of an `amcl_pose` from the truth at its stamp."""
        message = self.poses[number]
        at, turn = message.pose.pose.position, message.pose.pose.orientation
        truth = self.truth[ns_of(message.header.stamp)]
        heading = 2.0 * math.atan2(turn.z, turn.w)
        return math.dist((at.x, at.y), truth[:2]), abs(float(wrap_angle(heading - truth[2])))


class Bond:
    """What nav2's lifecycle manager hears of the bond."""

    def __init__(self, robot: Robot) -> None:
        self.heard: list[tuple[float, Any]] = []

        def on_status(message: Any) -> None:
            self.heard.append((time.monotonic(), message))

        robot.node.create_subscription(Status, "bond", on_status, 100)

    def is_alive(self) -> bool:
        return bool(self.heard) and self.heard[-1][1].active

    def longest_pause_s(self) -> float:
        return max(b[0] - a[0] for a, b in zip(self.heard, self.heard[1:], strict=False))


def time_of(ns: int) -> Any:
    return rclpy.time.Time(nanoseconds=ns).to_msg()


def ns_of(stamp: Any) -> int:
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def link(parent: str, child: str, at: PoseTuple, stamp_ns: int) -> Any:
    return messages_out.transform(at, stamp_ns, parent, child).transforms[0]


def pose_message(pose: PoseTuple, *, stamp_ns: int = 0, sigma: float = 0.2) -> Any:
    covariance = (sigma**2, 0.0, 0.0, 0.0, sigma**2, 0.0, 0.0, 0.0, sigma**2 / 4)
    return messages_out.pose_stamped(pose, covariance, stamp_ns, "map")
