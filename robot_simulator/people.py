"""People who walk about near the robot and stand in the laser's way."""

import numpy as np

from particle_filter.arrays import Points
from protocol.message import PoseTuple
from robot_simulator.free_space import FreeSpace

RADIUS_M = 0.25
_SPEED_M_S = 1.0
_NEAREST_M, _FARTHEST_M = 0.8, 10.0
"""From the robot; who is farther away is of no interest and comes in again nearer by."""
_TRIES = 20


class People:
    """Some people, always near the robot: those farther away would not matter.

    Args:
        count: how many.
        free_space: where they walk.
        rng: decides where they go.
    """

    def __init__(self, count: int, free_space: FreeSpace, rng: np.random.Generator) -> None:
        self._free_space, self._rng = free_space, rng
        self._headings = rng.uniform(-np.pi, np.pi, count)
        self._positions: Points = np.full((count, 2), np.inf)  # infinite: not here yet

    @property
    def positions(self) -> Points:
        """(P, 2) where they are [m]; fewer than `count` while some have not come in."""
        here = np.isfinite(self._positions[:, 0])
        return np.asarray(self._positions[here])

    def walk(self, map_from_robot: PoseTuple, seconds: float) -> None:
        """Everybody goes on straight ahead, or turns where there is no way on."""
        robot = np.array(map_from_robot[:2])
        for i, position in enumerate(self._positions):
            if not np.hypot(*(position - robot)) < _FARTHEST_M:
                self._positions[i] = self._entrance(robot)
                continue
            heading = self._headings[i]
            ahead = position + seconds * _SPEED_M_S * np.array([np.cos(heading), np.sin(heading)])
            leaves = np.hypot(*(ahead - robot)) > np.hypot(*(position - robot))
            if self._has_room(ahead) and (leaves or _is_off(ahead, robot)):
                self._positions[i] = ahead
            else:
                self._headings[i] = self._rng.uniform(-np.pi, np.pi)

    def _entrance(self, robot: Points) -> Points:
        """Somewhere free round the robot; nowhere when no place is found, until next time."""
        for _ in range(_TRIES):
            distance, bearing = self._rng.uniform([_NEAREST_M, -np.pi], [_FARTHEST_M, np.pi])
            place: Points = robot + distance * np.array([np.cos(bearing), np.sin(bearing)])
            if self._has_room(place):
                return place
        return np.full(2, np.inf)

    def _has_room(self, place: Points) -> bool:
        return self._free_space.clearance_m(place[0], place[1]) > RADIUS_M


def _is_off(place: Points, robot: Points) -> bool:
    """Nobody walks into the robot."""
    return bool(np.hypot(*(place - robot)) > _NEAREST_M)
