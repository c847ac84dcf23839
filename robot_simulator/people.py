"""People who walk near the robot and occlude the laser."""

import numpy as np

from particle_filter.arrays import Points
from protocol.message import PoseTuple
from robot_simulator.free_space import FreeSpace

RADIUS_M = 0.25
_SPEED_M_S = 1.0
_NEAREST_M, _FARTHEST_M = 0.8, 10.0
"""Limits of the distance from the robot; a person beyond the second one gets a new place."""
_TRIES = 20


class People:
    """People near the robot; each walks straight ahead until blocked."""

    def __init__(self, count: int, free_space: FreeSpace, rng: np.random.Generator) -> None:
        self._free_space, self._rng = free_space, rng
        self._headings = rng.uniform(-np.pi, np.pi, count)
        self._positions: Points = np.full((count, 2), np.inf)  # infinite: not placed yet

    @property
    def positions(self) -> Points:
        """(P, 2) positions, without those of people not placed yet [m]."""
        here = np.isfinite(self._positions[:, 0])
        return np.asarray(self._positions[here])

    def walk(self, map_from_robot: PoseTuple, seconds: float) -> None:
        """Move each person straight ahead for some seconds; a blocked person turns.

        A person far from the robot, or not placed yet, is placed near the robot.
        """
        robot = np.array(map_from_robot[:2])
        for i, position in enumerate(self._positions):
            if not np.hypot(*(position - robot)) < _FARTHEST_M:
                self._positions[i] = self._entrance(robot)
                continue
            heading = self._headings[i]
            ahead = position + seconds * _SPEED_M_S * np.array([np.cos(heading), np.sin(heading)])
            leaves = np.hypot(*(ahead - robot)) > np.hypot(*(position - robot))
            is_apart = np.hypot(*(ahead - robot)) > _NEAREST_M
            if self._has_room(ahead) and (leaves or is_apart):
                self._positions[i] = ahead
            else:
                self._headings[i] = self._rng.uniform(-np.pi, np.pi)

    def _entrance(self, robot: Points) -> Points:
        """Return a random free place near the robot [m]; infinite if none was found."""
        for _ in range(_TRIES):
            distance, bearing = self._rng.uniform([_NEAREST_M, -np.pi], [_FARTHEST_M, np.pi])
            place: Points = robot + distance * np.array([np.cos(bearing), np.sin(bearing)])
            if self._has_room(place):
                return place
        return np.full(2, np.inf)

    def _has_room(self, place: Points) -> bool:
        return self._free_space.clearance_m(place[0], place[1]) > RADIUS_M
