"""A simulated robot that takes lifts: it turns round in the cabin while the doors are closed."""

import math

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Pose
from clustermcl.protocol.floors import Floors
from clustermcl.simulator.free_space import FreeSpace
from clustermcl.simulator.robot import Robot

INSIDE_M, CABIN_M = 0.7, 1.0
"""Distances from the middle of a cabin: from which a robot rides; of its walls and doors."""
RIDE_S, EVERY_S = 8.0, 30.0
"""Length of a ride; time after one from which the robot drives to the lift again."""


class Lift:
    """The lifts of a building, and the ride of a robot in one of them.

    Attributes:
        middle: x, y of the cabin in which the robot rides, in the atlas [m]; None: in none.
        rides: rides that have begun.
    """

    def __init__(self, floors: Floors, rng: np.random.Generator) -> None:
        self._floors, self._rng = floors, rng
        self.middle: tuple[float, float] | None = None
        self.rides = 0
        self._left_s = self._since_s = 0.0

    def drive(self, robot: Robot, free_space: FreeSpace, seconds: float) -> None:
        """Move a robot that rides, or send it to a lift if it is time."""
        self._since_s += seconds
        if self.middle is not None:
            self._ride(robot, self.middle, seconds)
        elif self._since_s >= EVERY_S and (middle := self._nearest(robot)) is not None:
            x, y, _ = robot.map_from_robot
            if math.dist((x, y), middle) < INSIDE_M:
                self.middle, self._left_s = middle, RIDE_S
                self.rides += 1
            elif not robot.follows:
                robot.follow(free_space.path_to((x, y), middle))

    def _nearest(self, robot: Robot) -> tuple[float, float] | None:
        floor, _ = self._floors.on_floor(robot.map_from_robot)
        ends = [
            self._floors.in_atlas(floor, (*link.at[floor], 0.0))[:2]
            for link in self._floors.links
            if floor in link.at
        ]
        return min(ends, key=lambda end: math.dist(end, robot.map_from_robot[:2]), default=None)

    def _ride(self, robot: Robot, middle: tuple[float, float], seconds: float) -> None:
        robot.drive_at(0.0, math.pi / RIDE_S)
        before_s, self._left_s = self._left_s, self._left_s - seconds
        if self._left_s < RIDE_S / 2 <= before_s:
            ends = self._floors.rides(robot.map_from_robot)
            pose = ends[int(self._rng.integers(len(ends)))]
            x, y, _ = robot.map_from_robot
            self.middle = middle[0] + pose[0] - x, middle[1] + pose[1] - y
            robot.put(pose)
        if self._left_s <= 0.0:
            self.middle, self._since_s = None, 0.0
            robot.wander()

    def ranges(self, map_from_laser: Pose, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (beams,) ranges to the walls and the closed doors of the cabin [m]."""
        assert self.middle is not None  # only while the robot rides
        x, y = map_from_laser[0] - self.middle[0], map_from_laser[1] - self.middle[1]
        c, s = np.cos(map_from_laser[2] + angles), np.sin(map_from_laser[2] + angles)
        with np.errstate(divide="ignore"):
            along_x, along_y = (np.copysign(CABIN_M, c) - x) / c, (np.copysign(CABIN_M, s) - y) / s
        nearer: NDArray[np.float64] = np.minimum(along_x, along_y)
        return nearer
