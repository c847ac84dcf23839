"""A simulated robot among people, who walk near it and occlude its laser."""

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Points, Pose
from clustermcl.protocol.message import PoseTuple
from clustermcl.simulator.free_space import FreeSpace
from clustermcl.simulator.sensors import Lidar, LidarModel
from clustermcl.simulator.simulation import Simulation, Tick
from clustermcl.simulator.worlds.world import World

RADIUS_M = 0.25
_SPEED_M_S, _TICK_S = 1.0, 0.1
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


class WatchedLidar(Lidar):
    """A laser whose beams end at people too, who are discs."""

    def __init__(
        self, model: LidarModel, world: World, rng: np.random.Generator, people: People
    ) -> None:
        super().__init__(model, world.truth, rng)
        self._people = people

    def exact_ranges(self, map_from_laser: Pose) -> NDArray[np.float64]:
        ranges, people = super().exact_ranges(map_from_laser), self._people.positions
        return np.minimum(ranges, to_discs(map_from_laser, self.model.angles, people))


class CrowdSimulation(Simulation):
    """A simulation with a number of people near the robot."""

    def __init__(
        self,
        world: World,
        seed: int,
        people: int,
        lidar: LidarModel | None = None,
        start: PoseTuple | None = None,
    ) -> None:
        super().__init__(world, seed, lidar=lidar, start=start)
        lidar_rng, people_rng = (np.random.default_rng([seed, purpose]) for purpose in (3, 4))
        self._people = People(people, self._free_space, people_rng)
        self._lidar = WatchedLidar(self._lidar.model, world, lidar_rng, self._people)

    def __next__(self) -> Tick:
        tick = super().__next__()
        self._people.walk(self.map_from_robot, _TICK_S)
        return tick


def to_discs(
    map_from_laser: Pose, angles: NDArray[np.float64], discs: Points
) -> NDArray[np.float64]:
    """Return the (B,) distances to the nearest disc along each beam [m]; infinite: no hit.

    A disc that contains the laser is ignored, because it would occlude all beams.
    """
    if len(discs) == 0:
        return np.full(len(angles), np.inf)
    headings = map_from_laser[2] + angles
    x, y = (discs - map_from_laser[:2]).T
    along = np.outer(np.cos(headings), x) + np.outer(np.sin(headings), y)
    square = RADIUS_M**2 - (x**2 + y**2) + along**2
    hit = (square >= 0.0) & (along > 0.0) & (x**2 + y**2 > RADIUS_M**2)
    distance = np.where(hit, along - np.sqrt(np.maximum(square, 0.0)), np.inf)
    return np.asarray(distance.min(axis=1))
