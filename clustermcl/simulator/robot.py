"""A differential-drive robot that follows a route and then wanders."""

from itertools import pairwise
from math import atan2, cos, hypot, sin, tau
from typing import NamedTuple

import numpy as np

from clustermcl.filter.arrays import Points
from clustermcl.filter.poses import wrap_angle
from clustermcl.protocol.message import PoseTuple
from clustermcl.simulator.free_space import FreeSpace

RADIUS_M = 0.2
_TOP_SPEED_M_S, _TOP_TURN_RATE_RAD_S = 0.6, 1.0
_LOOK_AHEAD_M, _ARRIVED_M = 0.4, 0.1
"""Distance at which a point of the path is skipped: usually, and before a corner [m]."""
_TURN_PER_ERROR = 2.5
"""Turn rate for each radian of heading error [1/s]."""
_NO_DRIVE_ERROR_RAD = 0.8
"""Heading error above which the robot turns on the spot."""
_BLOCKED_S = 1.0
"""Time after which a blocked robot chooses another goal [s]."""
_FARTHEST_GOAL_M = 60.0
_COMMAND_S = 1.0
"""Time for which commanded rates are valid [s]."""


class Drive(NamedTuple):
    """A motion along an arc, during which speed and turn rate are constant."""

    distance_m: float
    turn_rad: float

    def part(self, share: float) -> "Drive":
        """Return the beginning of the arc, up to a share (0 to 1) of its length."""
        return Drive(self.distance_m * share, self.turn_rad * share)


class Robot:
    """A robot that drives along a route, then to random goals, and stops before obstacles.

    The route has (n, 2) points of the map [m]; the start pose is in the map, too.
    """

    def __init__(
        self,
        free_space: FreeSpace,
        map_from_robot: PoseTuple,
        route: Points,
        rng: np.random.Generator,
    ) -> None:
        self.map_from_robot = map_from_robot
        self._free_space, self._rng = free_space, rng
        self._speed_m_s, self._turn_rate_rad_s, self._blocked_s = 0.0, 0.0, 0.0
        self._path: list[tuple[float, float]] = _dense(
            np.vstack([map_from_robot[:2], route])
        ).tolist()
        self._next = 0
        self.follows = False
        """Whether the robot is on the way that `follow` gave it, or turns round."""
        self._rates: tuple[float, float] | None = None
        """Commanded speed and turn rate; None: the robot drives along the path."""
        self._rates_left_s = 0.0

    def drive_at(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Drive at these rates for one second, then stand until the next command or `wander`."""
        self._rates, self._rates_left_s = (speed_m_s, turn_rate_rad_s), _COMMAND_S
        self.follows = False

    def wander(self) -> None:
        """End driving at given rates, if it has begun, and drive to random goals."""
        if self._rates is not None:
            self._rates, self._path, self._next, self.follows = None, [], 0, False

    def turn_round(self) -> None:
        self._rates, self._rates_left_s = (0.0, _TOP_TURN_RATE_RAD_S), tau / _TOP_TURN_RATE_RAD_S
        self.follows = True

    def follow(self, points: Points) -> None:
        """Drive along (n, 2) points of the map [m], then to random goals."""
        self._rates, self._blocked_s = None, 0.0
        self._path, self._next, self.follows = points.tolist(), 0, True

    def put(self, map_from_robot: PoseTuple) -> None:
        """Move the robot to a pose, at rest and without a route."""
        self.map_from_robot = map_from_robot
        self._speed_m_s, self._turn_rate_rad_s, self._blocked_s = 0.0, 0.0, 0.0
        self._path, self._next = [], 0

    def move(self, seconds: float) -> Drive:
        """Drive for some seconds, update `map_from_robot`, and return the motion."""
        self._steer(seconds)
        drive = Drive(self._speed_m_s * seconds, self._turn_rate_rad_s * seconds)
        after, (x, y, _) = driven(self.map_from_robot, drive), self.map_from_robot
        room_m = self._free_space.clearance_m(after[0], after[1])
        # It bumps where the motion ends nearer to an obstacle than it is now.
        if room_m < RADIUS_M and room_m < self._free_space.clearance_m(x, y):
            self._speed_m_s, self._blocked_s = 0.0, self._blocked_s + seconds
            drive = Drive(0.0, drive.turn_rad)
            after = driven(self.map_from_robot, drive)
        self.map_from_robot = after
        return drive

    def _steer(self, seconds: float) -> None:
        if self.follows and self._rates_left_s <= 0.0:
            self.wander()
        if self._rates is None:
            wanted_speed, wanted_turn = self._rates_along_path()
        else:
            wanted_speed, wanted_turn = self._commanded(self._rates, seconds)
        self._turn_rate_rad_s = _towards(self._turn_rate_rad_s, wanted_turn, 4.0 * seconds)
        slow_down = abs(wanted_speed) < abs(self._speed_m_s)
        most = (1.5 if slow_down else 0.6) * seconds
        self._speed_m_s = _towards(self._speed_m_s, wanted_speed, most)

    def _commanded(self, rates: tuple[float, float], seconds: float) -> tuple[float, float]:
        """Return the commanded rates within the robot's limits; zero after the command expired."""
        if self._rates_left_s <= 0.0:
            return 0.0, 0.0
        self._rates_left_s -= seconds
        limits = _TOP_SPEED_M_S, _TOP_TURN_RATE_RAD_S
        speed, turn = (min(max(one, -most), most) for one, most in zip(rates, limits, strict=True))
        return speed, turn

    def _rates_along_path(self) -> tuple[float, float]:
        """Return speed and turn rate towards the path's next point; slower near obstacles."""
        error = self._bearing_of_next_point()
        limit = _TOP_TURN_RATE_RAD_S
        wanted_turn = min(max(_TURN_PER_ERROR * error, -limit), limit)
        x, y, _ = self.map_from_robot
        margin_m = max(0.0, self._free_space.clearance_m(x, y) - RADIUS_M)
        top_speed = min(_TOP_SPEED_M_S, 0.1 + 2.0 * margin_m)
        return top_speed * max(0.0, 1.0 - abs(error) / _NO_DRIVE_ERROR_RAD), wanted_turn

    def _bearing_of_next_point(self) -> float:
        """Return the bearing of the path's next point in the robot's frame [rad].

        At the end of the path, or when blocked for too long, choose a new path first.
        """
        x, y, heading = self.map_from_robot
        self._advance(x, y)
        while self._next >= len(self._path) or self._blocked_s > _BLOCKED_S:
            way_out = [self._free_space.roomiest_near(x, y)] if self._blocked_s > 0.0 else []
            path = self._free_space.random_path(x, y, _FARTHEST_GOAL_M, self._rng)
            self._path, self._next, self._blocked_s = [*way_out, *path.tolist()], 0, 0.0
            self.follows = False
            self._advance(x, y)
        goal_x, goal_y = self._path[self._next]
        return wrap_angle(atan2(goal_y - y, goal_x - x) - heading)

    def _advance(self, x: float, y: float) -> None:
        """Skip near points of the path; skip a point before a corner only when it is reached."""
        while self._next < len(self._path):
            goal_x, goal_y = self._path[self._next]
            distance_m = hypot(goal_x - x, goal_y - y)
            if distance_m >= _LOOK_AHEAD_M:
                return
            if self._next + 1 < len(self._path) and distance_m >= _ARRIVED_M:
                next_x, next_y = self._path[self._next + 1]
                if not self._free_space.has_room_between(x, y, next_x, next_y):
                    return
            self._next += 1


def driven(map_from_robot: PoseTuple, drive: Drive) -> PoseTuple:
    """Return the pose after an arc; exact for a constant speed and turn rate."""
    x, y, heading = map_from_robot
    half = 0.5 * drive.turn_rad
    chord_m = drive.distance_m * (sin(half) / half if abs(half) > 1e-9 else 1.0)
    bearing, after = heading + half, wrap_angle(heading + drive.turn_rad)
    return x + chord_m * cos(bearing), y + chord_m * sin(bearing), after


def _towards(now: float, wanted: float, most: float) -> float:
    return now + min(max(wanted - now, -most), most)


def _dense(corners: Points) -> Points:
    """Return points about 0.1 m apart on the lines between corners [m], without the first."""
    pieces = [
        np.linspace(a, b, max(2, int(np.hypot(*(b - a)) / 0.1) + 1))[1:]
        for a, b in pairwise(corners)
    ]
    return np.vstack(pieces) if pieces else corners[:0]
