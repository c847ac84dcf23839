"""Simulates a robot in a world: odometry, laser scans, ground truth, and a bridge's steps."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import hypot

import numpy as np
from msgspec.structs import replace

from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import LaserReading, Observation, OdometryReading, Reading, Scan
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.step_maker import StepMaker
from clustermcl.simulator.free_space import FreeSpace
from clustermcl.simulator.lift import Lift
from clustermcl.simulator.robot import RADIUS_M, Drive, Robot, driven
from clustermcl.simulator.sensors import Lidar, LidarModel, Odometer
from clustermcl.simulator.worlds.world import World

_SENDER = "simulator"
_PIECE_NS = 50_000_000
"""Interval of odometry readings: 20 Hz."""
_SCAN_SHARE = 0.4
"""Time of a scan after an odometry reading, as a share of the interval of odometry readings."""
_KIDNAP_TRIES, _KIDNAP_FARTHEST = 40, 10


@dataclass(frozen=True)
class Tick:
    """The readings of 0.1 s: two odometry readings and a scan between them."""

    odometry: tuple[OdometryReading, OdometryReading]
    laser: LaserReading
    map_from_robot: PoseTuple
    """Ground truth at the time of the scan."""
    observations: tuple[Observation, ...] = ()
    """Those of other sensors at the time of the scan."""

    @property
    def readings(self) -> tuple[OdometryReading, LaserReading, OdometryReading]:
        return self.odometry[0], self.laser, self.odometry[1]

    @property
    def messages(self) -> tuple[Reading | Observation, ...]:
        """The readings and observations in the order of time."""
        return self.odometry[0], *self.observations, self.laser, self.odometry[1]


class Simulation:
    """An endless iterator of ticks; the same world and seed give the same ticks, bit for bit.

    A given start pose replaces the world's start pose and route.

    Raises:
        NoRoomError: the robot fits nowhere in this world.
    """

    def __init__(
        self,
        world: World,
        seed: int,
        *,
        lidar: LidarModel | None = None,
        start: PoseTuple | None = None,
    ) -> None:
        rngs = [np.random.default_rng([seed, purpose]) for purpose in range(6)]
        self.world = world
        self._free_space = FreeSpace(world.truth)
        self._place_rng = rngs[0]
        begin = start if start is not None else world.start
        pose = begin if begin is not None else self._free_space.random_pose(rngs[0])
        pose = self._free_space.where_it_fits(pose, RADIUS_M)
        route = np.array(world.route if start is None else (), np.float64).reshape(-1, 2)
        self.robot = Robot(self._free_space, pose, route, rngs[1])
        self._odometer = Odometer(rngs[2])
        self._lidar = Lidar(lidar or LidarModel(), world.truth, rngs[3])
        self._observation_rng = rngs[5]
        floors = world.map.floors
        self.lift = Lift(floors, np.random.default_rng([seed, 6])) if floors.links else None
        self._now_ns = 0

    @property
    def map_from_robot(self) -> PoseTuple:
        return self.robot.map_from_robot

    def __iter__(self) -> Iterator[Tick]:
        return self

    def __next__(self) -> Tick:
        if self.lift is not None:
            self.lift.drive(self.robot, self._free_space, 2 * _PIECE_NS * 1e-9)
        begin_ns, begin = self._now_ns, self.map_from_robot
        first, drive = self._drive_on()
        scan_pose = driven(begin, drive.part(_SCAN_SHARE))
        laser = self._scan(begin_ns + round(_SCAN_SHARE * _PIECE_NS), scan_pose)
        second, _ = self._drive_on()
        observe, marks, rng = self.world.observe, self.world.landmarks, self._observation_rng
        observed = observe(laser.stamp_ns, scan_pose, marks, rng) if observe else ()
        return Tick((first, second), laser, scan_pose, tuple(observed))

    def kidnap(self, map_from_robot: PoseTuple | None = None) -> PoseTuple:
        """Move the robot, unseen by odometry, to a pose or far away; return its new pose.

        The nearest free position is used if the robot does not fit there.
        """
        pose = map_from_robot if map_from_robot is not None else self._far_pose()
        self.robot.put(self._free_space.where_it_fits(pose, RADIUS_M))
        return self.map_from_robot

    def _drive_on(self) -> tuple[OdometryReading, Drive]:
        """Drive until the next odometry reading; return the reading before, and the motion."""
        reading = OdometryReading(
            sender=_SENDER,
            stamp_ns=self._now_ns,
            odom_from_robot=self._odometer.odom_from_robot,
        )
        drive = self.robot.move(_PIECE_NS * 1e-9)
        self._odometer.read(drive)
        self._now_ns += _PIECE_NS
        return reading, drive

    def _scan(self, stamp_ns: int, map_from_robot: PoseTuple) -> LaserReading:
        model, lift = self._lidar.model, self.lift
        in_cabin = lift.ranges if lift and lift.middle is not None else None
        ranges = self._lidar.scan(map_from_robot, in_cabin)
        return LaserReading(
            sender=_SENDER,
            stamp_ns=stamp_ns,
            ranges=ArrayBlob.of(ranges, "float32"),
            angle_min_rad=float(model.angles[0]),
            angle_step_rad=model.angle_step_rad,
            range_max_m=model.range_max_m,
            robot_from_laser=model.robot_from_laser,
        )

    def _far_pose(self) -> PoseTuple:
        poses = [self._free_space.random_pose(self._place_rng) for _ in range(_KIDNAP_TRIES)]
        x, y, _ = self.map_from_robot
        poses.sort(key=lambda pose: -hypot(pose[0] - x, pose[1] - y))
        return poses[int(self._place_rng.integers(_KIDNAP_FARTHEST))]


def simulated_steps(
    simulation: Simulation,
    settings: BridgeSettings,
    grid_map: GridMap | None = None,
    *,
    steps: int | None = None,
) -> Iterator[tuple[Scan, PoseTuple]]:
    """Yield the steps that a bridge would make, each with the true pose; without `steps`, no end.

    `grid_map` is the one to localize in; None: the world's own.
    """
    known, landmarks = grid_map or simulation.world.map, simulation.world.landmarks
    maker = StepMaker(settings, known.digest, "simulator", landmarks=landmarks, floors=known.floors)
    made = 0
    while made != steps:
        tick = next(simulation)
        for message in tick.messages:
            if isinstance(message, Observation):
                maker.observe(message)
            elif (scan := maker.on_reading(message)) is not None:
                made += 1
                yield replace(scan, last=made == steps), tick.map_from_robot
