"""Reads buildings: YAML files that name the maps of several floors, and the links between them.

floors:
  ground: ground/map.yaml                 # or {map: ground/map.yaml, height_m: 0.0}
  third: {map: third/map.yaml, height_m: 8.4}
links:
  - {name: north lift, radius_m: 1.5, at: {ground: [12.1, 3.4], third: [12.0, 3.6]}}

Files of `multi_level_map_server` are read too: ``maps`` with ``yaml`` and ``origin`` of each level,
and ``links`` from one point to another.
"""

import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta

from clustermcl.filter.arrays import UNKNOWN, Cells
from clustermcl.filter.poses import compose
from clustermcl.protocol.answers import MAX_FLOORS
from clustermcl.protocol.conversion import converted
from clustermcl.protocol.errors import MapFileError, printable
from clustermcl.protocol.floors import MAX_LINKS, Floor, FloorName, Floors, Link
from clustermcl.protocol.message import Coordinate, Finite
from clustermcl.recordings.maps.grid_map import MAX_CELLS, GridMap
from clustermcl.runtime.compressed import first_bytes, too_long_problem
from clustermcl.runtime.yaml_text import yaml_of

GAP_M = 40.0
"""Distance between floors in the atlas, in unknown ground: indoors, lasers see less far."""
MAX_BUILDING_BYTES = 64 * 1024
_SAME_CELL = 1e-6
_IS_BUILDING = re.compile(rb"^[ \t{\xef\xbb\xbf]*[\"']?(floors|maps)[\"']?\s*:", re.MULTILINE)
_PACKAGE = re.compile(r"package://[^/]+/|\$\(find [^)]+\)/")

_File: TypeAlias = Annotated[str, Meta(min_length=1)]


class _Floor(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    map: _File
    height_m: Finite = 0.0


class _Building(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    floors: Annotated[dict[FloorName, _File | _Floor], Meta(min_length=1, max_length=MAX_FLOORS)]
    links: Annotated[tuple[Link, ...], Meta(max_length=MAX_LINKS)] = ()

    def __post_init__(self) -> None:
        for link in self.links:
            name = printable(link.name)
            if unknown := sorted(link.at.keys() - self.floors.keys()):
                held = ", ".join(self.floors)
                raise ValueError(
                    f"link {name!r} names the unknown floor {unknown[0]!r}; floors are {held}"
                )
            if len(link.at) < 2:
                raise ValueError(f"link {name!r} begins and ends on one floor")

    def files(self, path: Path) -> dict[str, Path]:
        return {
            name: _found(floor if isinstance(floor, str) else floor.map, path)
            for name, floor in self.floors.items()
        }


class _Level(msgspec.Struct, frozen=True):
    yaml: _File
    origin: Annotated[tuple[Finite, ...], Meta(min_length=3, max_length=7)] = (0.0, 0.0, 0.0)
    """x, y, yaw; or x, y, z and angles or a quaternion."""


class _Point(msgspec.Struct, frozen=True):
    level_id: FloorName
    point: tuple[Coordinate, Coordinate, Coordinate]


class _LevelLink(msgspec.Struct, frozen=True):
    from_point: _Point
    to_point: _Point

    def link(self) -> Link:
        one, other = self.from_point, self.to_point
        at = {end.level_id: end.point[:2] for end in (one, other)}
        return Link(f"{one.level_id} - {other.level_id}"[:64], at)


class _Levels(msgspec.Struct, frozen=True):
    maps: Annotated[dict[FloorName, _Level], Meta(min_length=1, max_length=MAX_FLOORS)]
    links: Annotated[tuple[_LevelLink, ...], Meta(max_length=MAX_LINKS)] = ()

    def building(self) -> _Building:
        floors: dict[FloorName, str | _Floor] = {
            name: _Floor(level.yaml, level.origin[2] if len(level.origin) > 3 else 0.0)
            for name, level in self.maps.items()
        }
        return _Building(floors, tuple(link.link() for link in self.links))


def is_building(content: bytes) -> bool:
    """Return whether a text is that of a building, by its first keys."""
    return _IS_BUILDING.search(content) is not None


def load_building(content: bytes, path: Path, load_map: Callable[[Path], GridMap]) -> GridMap:
    """Read a building as one map, the atlas, with its `floors`; that of one floor is its map.

    Raises:
        MapFileError: it is not such a file, a map cannot be read, all maps together are too large,
            or a link names an unknown floor, or a position outside of it.
    """
    building, maps = _parsed(content, path), dict[str, GridMap]()
    for name, file in building.files(path).items():
        try:
            maps[name] = load_map(file)
        except MapFileError as error:
            problem = f"floor {printable(name)!r}: {error.path}: {error.problem}"
            raise MapFileError(path, problem) from error
        if problem := _size_problem(maps):
            raise MapFileError(path, f"floor {printable(name)!r}: {problem}")
    if len(maps) == 1:
        return maps.popitem()[1]
    heights_m = {n: f.height_m for n, f in building.floors.items() if isinstance(f, _Floor)}
    atlas = atlas_of(maps, building.links, heights_m)
    for link in building.links:
        for name, (x, y) in link.at.items():
            floor = atlas.floors.floor(name)
            if floor.distance_m(x + floor.shift[0], y + floor.shift[1]) > 0.0:
                where = f"{printable(link.name)!r} is outside of floor {printable(name)!r}"
                raise MapFileError(path, f"link {where}: x {x:g} m, y {y:g} m is not on its map")
    return atlas


def floor_files(path: Path) -> dict[str, Path]:
    """Return the map file of each floor of a building; empty if the file is another map.

    Raises:
        MapFileError: it is an unusable building.
    """
    content = first_bytes(path, MAX_BUILDING_BYTES + 1, MapFileError) if path.is_file() else b""
    files = _parsed(content, path).files(path) if is_building(content) else {}
    return files if len(files) > 1 else {}


def atlas_of(
    maps: Mapping[str, GridMap], links: tuple[Link, ...], heights_m: Mapping[str, float]
) -> GridMap:
    """Return several floors as one map: side by side along x, in cells of the finest."""
    cell_m = min(each.cell_m for each in maps.values())
    pieces = {name: _in_own_axes(each, cell_m) for name, each in maps.items()}
    gap, shapes = math.ceil(GAP_M / cell_m), [cells.shape for cells, _, _ in pieces.values()]
    size = max(rows for rows, _ in shapes), sum(cols + gap for _, cols in shapes) - gap
    atlas: Cells = np.full(size, UNKNOWN, np.int8)
    begin, floors, remarks = 0, list[Floor](), list[str]()
    for name, (cells, x, y) in pieces.items():
        rows, cols = cells.shape
        atlas[:rows, begin : begin + cols] = cells
        low, high = (begin * cell_m, 0.0), ((begin + cols) * cell_m, rows * cell_m)
        floors.append(Floor(name, (low[0] - x, -y), low, high, heights_m.get(name, 0.0)))
        remarks += [f"floor {name}: {remark}" for remark in maps[name].remarks]
        if cells is not maps[name].cells:
            remarks.append(f"floor {name}: resampled to cells of {cell_m:g} m along its axes")
        begin += cols + gap
    atlas.flags.writeable = False
    named = Floors(tuple(floors), links)
    return GridMap(atlas, cell_m, (0.0, 0.0, 0.0), remarks=tuple(remarks), floors=named)


def _parsed(content: bytes, path: Path) -> _Building:
    if len(content) > MAX_BUILDING_BYTES:
        raise MapFileError(path, too_long_problem(MAX_BUILDING_BYTES))
    values, _ = yaml_of(content, path, MapFileError, is_unique=True)
    kind: Any = _Levels if isinstance(values, dict) and "maps" in values else _Building
    try:
        read: _Levels | _Building = converted(values, kind)
        return read.building() if isinstance(read, _Levels) else read
    except (ValueError, OverflowError, RecursionError) as error:
        raise MapFileError(path, f"not a building: {printable(str(error))}") from None


def _found(file: str, building: Path) -> Path:
    """Return the path of a map; that of a ROS package is looked for above the building's file."""
    package = _PACKAGE.match(file)
    if package is None:
        return building.parent / file
    rest = file[package.end() :]
    above = (folder / rest for folder in building.absolute().parents)
    return next((each for each in above if each.is_file()), building.parent / rest)


def _size_problem(maps: Mapping[str, GridMap]) -> str:
    cell_m = min(each.cell_m for each in maps.values())
    boxes = np.array([_box(each) for each in maps.values()])
    width, height = (boxes[:, 2:] - boxes[:, :2]).T
    count = (width.sum() + GAP_M * (len(maps) - 1)) / cell_m * (height.max() / cell_m)
    if count <= MAX_CELLS:
        return ""
    problem = f"with it, floors and the ground between them have {count:.3g} cells of {cell_m:g} m"
    return f"{problem}; at most {MAX_CELLS} are read: use larger cells or fewer floors"


def _box(grid_map: GridMap) -> tuple[float, float, float, float]:
    """Return least x, least y, largest x and largest y of a map's grid in its frame [m]."""
    width, height = grid_map.size_m
    corners = np.array([(x, y, 0.0) for x in (0.0, width) for y in (0.0, height)])
    x, y, _ = compose(np.array(grid_map.map_from_grid), corners).T
    return float(x.min()), float(y.min()), float(x.max()), float(y.max())


def _in_own_axes(grid_map: GridMap, cell_m: float) -> tuple[Cells, float, float]:
    """Return the cells of a map along the axes of its frame, and x and y of their corner [m].

    Each cell is the one of the map at its centre.
    """
    x0, y0, heading = grid_map.map_from_grid
    if heading == 0.0 and grid_map.cell_m <= cell_m * (1.0 + _SAME_CELL):
        return grid_map.cells, x0, y0
    left, low, right, high = _box(grid_map)
    x = left + (np.arange(math.ceil((right - left) / cell_m)) + 0.5) * cell_m - x0
    c, s = math.cos(heading), math.sin(heading)
    source, (rows, cols) = grid_map.cells, grid_map.cells.shape
    cells: Cells = np.full((math.ceil((high - low) / cell_m), len(x)), UNKNOWN, np.int8)
    for row, into in enumerate(cells):
        y = low + (row + 0.5) * cell_m - y0
        col = np.floor((c * x + s * y) / grid_map.cell_m).astype(np.int64)
        at_row = np.floor((c * y - s * x) / grid_map.cell_m).astype(np.int64)
        inside = (col >= 0) & (col < cols) & (at_row >= 0) & (at_row < rows)
        into[inside] = source[at_row[inside], col[inside]]
    return cells, left, low
