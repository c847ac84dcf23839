"""A simulated robot for trying the library without a robot."""

from __future__ import annotations  # `help` shows names of types, not their definitions

from collections import deque
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clustermcl.protocol.message import PoseTuple
from clustermcl.readings import Reading
from clustermcl.runtime.sources import Simulated
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.worlds.catalogue import simulated_world


class SimulatedRobot:
    """An endless iterator over the readings of a robot that drives about a map.

        robot = SimulatedRobot("map.yaml")
        mcl = ClusterMCL(robot.map)
        for reading in itertools.islice(robot, 1000):
            mcl.update(reading)

    The same arguments give the same readings, bit for bit. A tenth of a second of its time has
    two odometry readings, and a scan of 181 beams of up to 12 m between them.

    Args:
        world: a map file, or the name of a world, such as ``office``.
        seed: seed of all random numbers, the start pose included.
        start: start pose in the map: x [m], y [m], heading [rad]; None: a random one.

    Attributes:
        map: the map of the world, with its landmarks.
        pose: (3,) true pose at the last reading's scan: x [m], y [m], heading [rad].

    Raises:
        ClusterMclError: there is no such file or world, or the robot fits nowhere in it.
    """

    def __init__(self, world: Path | str, *, seed: int = 0, start: PoseTuple | None = None) -> None:
        found = simulated_world(Simulated(str(world)))
        self._simulation = Simulation(found, seed, start=start)
        self._left: deque[Reading] = deque()
        self.map = found.map.with_landmarks(found.landmarks)
        self.pose: NDArray[np.float64] = np.array(self._simulation.map_from_robot)

    def __iter__(self) -> Iterator[Reading]:
        return self

    def __next__(self) -> Reading:
        if not self._left:
            tick = next(self._simulation)
            before, scan, after = tick.readings
            self._left.extend((Reading.of(before), Reading.of(scan), Reading.of(after)))
            self.pose = np.array(tick.map_from_robot)
        return self._left.popleft()
