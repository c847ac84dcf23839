"""A world: the map for the localizer, and the true map in which the robot drives."""

from dataclasses import dataclass

import numpy as np

from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN, Cells
from clustermcl.protocol.errors import ClusterMclError
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Landmark
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.simulator.sensors import Observe

Waypoint = tuple[float, float]
"""x [m], y [m] in the map."""


class UnknownWorldError(ClusterMclError):
    """No simulated world has this name."""

    def __init__(self, name: str, *, known: tuple[str, ...]) -> None:
        self.name, self.known = name, known
        super().__init__(f"no simulated world {name!r}; the worlds are {', '.join(known)}")


@dataclass(frozen=True, eq=False, kw_only=True)
class World:
    """A simulated world.

    Args:
        map: the map for the localizer.
        truth: the true map, which differs from `map` if `map` is outdated.
        start: start pose of the robot: x [m], y [m], heading [rad]; None: random.
        route: points that the robot visits before it drives to random goals.
        landmarks: of the map.
        observe: the robot's other sensor; None: it has only a laser.
    """

    map: GridMap
    truth: GridMap
    start: PoseTuple | None = None
    route: tuple[Waypoint, ...] = ()
    landmarks: tuple[Landmark, ...] = ()
    observe: Observe | None = None


def world_from_map(
    grid_map: GridMap, start: PoseTuple | None = None, route: tuple[Waypoint, ...] = ()
) -> World:
    return World(map=grid_map, truth=grid_map, start=start, route=route)


CELL_M = 0.05
_WALL_CELLS = 3


class Canvas:
    """A grid on which a world is drawn; cells are first unknown, and the origin is its middle.

    Coordinates are rounded to boundaries of cells, so a plan and its mirror image are symmetric
    cell by cell.
    """

    def __init__(self, width_m: float, height_m: float) -> None:
        self.cells: Cells = np.full(
            (2 * round(height_m / 2 / CELL_M), 2 * round(width_m / 2 / CELL_M)),
            UNKNOWN,
            dtype=np.int8,
        )

    def floor(self, x_min: float, y_min: float, x_max: float, y_max: float) -> None:
        """Make the cells of a rectangle free; coordinates in metres."""
        self._fill(FREE, x_min, y_min, x_max, y_max)

    def block(self, x_min: float, y_min: float, x_max: float, y_max: float) -> None:
        self._fill(OCCUPIED, x_min, y_min, x_max, y_max)

    def add_walls(self) -> None:
        """Make unknown cells within three cells of a free cell occupied."""
        from scipy.ndimage import binary_dilation  # noqa: PLC0415 - 16 MB, not for every command

        near = binary_dilation(self.cells == FREE, np.ones((2 * _WALL_CELLS + 1,) * 2, bool))
        self.cells[near & (self.cells == UNKNOWN)] = OCCUPIED

    def repeat_turned(self, times: int) -> None:
        """Repeat the drawing, rotated about the middle, `times` times (2 or 4) in a full turn."""
        drawn = self.cells.copy()
        for quarters in range(4 // times, 4, 4 // times):
            turned = np.rot90(drawn, quarters)
            added = turned != UNKNOWN
            self.cells[added] = turned[added]

    def add(self, furniture: "Canvas") -> None:
        self.cells[furniture.cells == OCCUPIED] = OCCUPIED

    def grid_map(self) -> GridMap:
        rows, cols = self.cells.shape
        origin = (-cols / 2 * CELL_M, -rows / 2 * CELL_M, 0.0)
        return GridMap(cells=self.cells, cell_m=CELL_M, map_from_grid=origin)

    def _fill(self, value: int, x_min: float, y_min: float, x_max: float, y_max: float) -> None:
        rows, cols = self.cells.shape
        left, right = (round(x / CELL_M) + cols // 2 for x in (x_min, x_max))
        low, high = (round(y / CELL_M) + rows // 2 for y in (y_min, y_max))
        if left < 0 or low < 0 or right > cols or high > rows or left >= right or low >= high:
            raise ValueError(
                f"({x_min}, {y_min}, {x_max}, {y_max}) m is not on the canvas, or empty"
            )
        self.cells[low:high, left:right] = value
