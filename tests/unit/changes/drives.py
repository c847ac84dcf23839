"""A robot that drives through a room whose walls are not as mapped."""

import itertools
from collections import Counter
from collections.abc import Iterator

import numpy as np

from clustermcl.changes.collector import ChangeCollector
from clustermcl.filter.arrays import FREE, OCCUPIED, Cells
from clustermcl.filter.laser.ray_casting import cast_rays_from_poses, jump_field
from clustermcl.protocol.answers import State
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan
from clustermcl.recordings.maps.grid_map import GridMap
from tests.unit.evaluation.places import place

ANGLES = np.linspace(-np.pi, np.pi, 360, endpoint=False)
ASIDE = (1.2, 0.7)
SHELF, CHAIR = np.s_[20:24, 60:80], np.s_[60:64, 40:44]
"""What is gone, and what is new: 0.2 m x 1 m of the map, and 0.2 m x 0.2 m of free ground."""


def room(*obstacles: tuple[slice, slice]) -> GridMap:
    """8 m x 5 m."""
    cells: Cells = np.full((100, 160), FREE, np.int8)
    cells[[0, 1, -2, -1], :] = cells[:, [0, 1, -2, -1]] = OCCUPIED
    cells[70:90, 100:104] = OCCUPIED
    for obstacle in obstacles:
        cells[obstacle] = OCCUPIED
    return GridMap(cells, 0.05, (-1.0, -2.0, 0.0))


OLD, TRUE = room(SHELF), room(CHAIR)
PILLARS = (np.s_[84:98, 8:30], np.s_[2:16, 118:150], np.s_[90:98, 60:70], np.s_[40:52, 145:158])
"""With these, the room is unlike its mirror image."""


def path(first: int, count: int) -> Iterator[PoseTuple]:
    """Back and forth along the room, 0.25 m a step."""
    along = itertools.cycle([*np.arange(0.5, 5.5, 0.25), *np.arange(5.5, 0.5, -0.25)])
    for number, x in enumerate(itertools.islice(along, first, first + count)):
        yield float(x), 0.4 + 0.5 * float(np.sin(x)), 0.1 * number


def scan_at(true: GridMap, pose: PoseTuple, step: int, digest: str, people: float = 0.0) -> Scan:
    rng, noise = np.random.default_rng(step), 0.01
    at = np.array([pose])
    jumps = true.grid.once("jumps", lambda: jump_field(true.cells))
    ranges = cast_rays_from_poses(jumps, true.grid, at, ANGLES, 12.0)[0]
    ranges += noise * rng.standard_normal(len(ranges))
    short = rng.random(len(ranges)) < people
    ranges[short] *= rng.random(np.count_nonzero(short))
    return Scan(
        sender="test",
        step=step,
        stamp_ns=step * 10**9,
        odom_from_robot=pose,
        robot_from_laser=(0.0, 0.0, 0.0),
        angle_min_rad=-np.pi,
        angle_step_rad=float(ANGLES[1] - ANGLES[0]),
        range_max_m=12.0,
        ranges=ArrayBlob.of(ranges, "float32"),
        map_digest=digest,
    )


class Drive:
    """Steps of one robot, believed at the true pose and an offset: cluster 1; or at `ASIDE`: 2."""

    def __init__(self, grid_map: GridMap = OLD) -> None:
        self.map, self.step = grid_map, 0
        self.collector = ChangeCollector(grid_map)

    def steps(
        self,
        count: int,
        true: GridMap = TRUE,
        *,
        off: tuple[float, float] = (0.0, 0.0),
        cluster: int = 1,
        people: float = 0.0,
        state: State = "localized",
    ) -> "Drive":
        for x, y, heading in path(self.step, count):
            scan = scan_at(true, (x, y, heading), self.step, self.map.digest, people)
            believed = [place(0.9, (x + off[0], y + off[1], heading), cluster=cluster)]
            if state == "ambiguous":
                believed.append(place(0.1, (x + ASIDE[0], y + ASIDE[1], heading), cluster=2))
            self.collector.on_step(scan, state, believed)
            self.step += 1
        return self

    def kinds(self) -> dict[int, int]:
        """Return the numbers of changed cells by kind."""
        return dict(Counter(self.collector.changes("test").cells.array()[:, 1].tolist()))
