"""The messages of a run log that Foxglove draws, as JSON objects.

Their fields follow https://docs.foxglove.dev/docs/sdk/schemas. The messages that `run_log` reads
also have the fields of one of the classes below, which Foxglove ignores.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Any, TypeAlias

import msgspec
import numpy as np

from clustermcl.filter.arrays import OCCUPIED
from clustermcl.protocol.answers import Hypothesis
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.floors import ONE_MAP, Floors
from clustermcl.protocol.message import Finite, PoseTuple, Positive, ScanStep, Stamp, ellipse_axes
from clustermcl.protocol.steps import MAX_BEAMS, Landmark, LaserBeams, Scan
from clustermcl.recordings.maps.grid_map import GridMap, cells_of, coarse

Json: TypeAlias = dict[str, Any]

_FAR_M = 1e6
_Range: TypeAlias = Annotated[float, msgspec.Meta(ge=0.0, le=_FAR_M)]
MAP, ODOM, BASE = "map", "odom", "base_link"
"""Frames, as ROS calls them (REP 105)."""
_INT8, _INFO = 2, 2
_SIGMAS = 2.0
"""Radius of an ellipse in standard deviations; it holds 86 % of a Gaussian in the plane."""
_MIN_SIGMA_M = 0.02
_ARROW = {"shaft_length": 0.6, "shaft_diameter": 0.08, "head_length": 0.15, "head_diameter": 0.16}
_TEXT_M = 0.3
_COLOURS = (
    (0.12, 0.47, 0.71), (1.0, 0.5, 0.05), (0.17, 0.63, 0.17), (0.84, 0.15, 0.16),
    (0.58, 0.4, 0.74), (0.55, 0.34, 0.29), (0.89, 0.47, 0.76), (0.09, 0.75, 0.81),
)  # fmt: skip


class LaserFields(msgspec.Struct, frozen=True, kw_only=True):
    """The beams of one laser in a step, as in `Scan`; a range of 0 means no return."""

    step: ScanStep
    stamp_ns: Stamp
    odom_from_robot: PoseTuple
    robot_from_laser: PoseTuple
    angle_min_rad: Finite
    angle_step_rad: Finite
    range_max_m: _Range
    ranges: Annotated[list[_Range], msgspec.Meta(max_length=MAX_BEAMS)]
    map_digest: str

    def beams(self) -> LaserBeams:
        return LaserBeams(
            robot_from_laser=self.robot_from_laser,
            angle_min_rad=self.angle_min_rad,
            angle_step_rad=self.angle_step_rad,
            range_max_m=self.range_max_m,
            ranges=ArrayBlob.of(np.array(self.ranges), "float32"),
        )


def laser_scan(scan: Scan, beams: Scan | LaserBeams) -> Json:
    """Return the beams of one laser as `foxglove.LaserScan`, with the `LaserFields`."""
    ranges, range_max_m = beams.ranges.array().astype(np.float64), min(beams.range_max_m, _FAR_M)
    with np.errstate(invalid="ignore"):
        ranges[~((ranges > 0.0) & (ranges < range_max_m))] = 0.0
    short = np.round(ranges, 4)  # the same number in 32 bits, unless finer than 0.1 mm
    own = LaserFields(
        step=scan.step,
        stamp_ns=scan.stamp_ns,
        odom_from_robot=scan.odom_from_robot,
        robot_from_laser=beams.robot_from_laser,
        angle_min_rad=beams.angle_min_rad,
        angle_step_rad=beams.angle_step_rad,
        range_max_m=range_max_m,
        ranges=np.where(short.astype(np.float32) == ranges, short, ranges).tolist(),
        map_digest=scan.map_digest,
    )
    return msgspec.structs.asdict(own) | {
        **posed(beams.robot_from_laser, scan.stamp_ns, BASE),
        "start_angle": beams.angle_min_rad,
        "end_angle": beams.angle_min_rad + beams.angle_step_rad * (len(ranges) - 1),
        "intensities": [],
    }


class LinkFields(msgspec.Struct, frozen=True):
    """The pose of a frame in its parent; the pose that Foxglove draws is rounded."""

    stamp_ns: Stamp
    child_frame_id: str
    parent_from_child: PoseTuple


def frame_transform(stamp_ns: int, parent: str, child: str, pose: PoseTuple) -> Json:
    """Return the pose of `child` in `parent` as `foxglove.FrameTransform`, with `LinkFields`."""
    drawn = _pose(pose)
    return msgspec.structs.asdict(LinkFields(stamp_ns, child, pose)) | {
        "timestamp": _time(stamp_ns),
        "parent_frame_id": parent,
        "translation": drawn["position"],
        "rotation": drawn["orientation"],
    }


class MapFields(msgspec.Struct, frozen=True):
    """A map in ROS's values: 0 is free, 100 occupied, -1 unknown."""

    cell_m: Positive
    map_from_grid: PoseTuple
    column_count: Annotated[int, msgspec.Meta(gt=0, lt=2**31)]
    data: bytes
    landmarks: tuple[Landmark, ...] = ()
    floors: Floors = ONE_MAP

    def grid_map(self) -> GridMap:
        """Return the map.

        Raises:
            ValueError: the bytes are not a map.
        """
        occupancy = np.frombuffer(self.data, np.int8).reshape(-1, self.column_count)
        cells, place = cells_of(occupancy), self.map_from_grid
        return GridMap(cells, self.cell_m, place, self.landmarks, floors=self.floors)


def grid(grid_map: GridMap, stamp_ns: int, max_cells: int) -> Json:
    """Return a map as `foxglove.Grid`, with the `MapFields`.

    A map of more than `max_cells` is downsampled, see `coarse`.
    """
    every = math.ceil(math.sqrt(grid_map.cells.size / max_cells))
    cells = coarse(grid_map.cells, every) if every > 1 else grid_map.cells
    cell_m, cols = grid_map.cell_m * every, cells.shape[1]
    data = np.where(cells == OCCUPIED, 100, cells).astype(np.int8).tobytes()
    place, marks = grid_map.map_from_grid, grid_map.landmarks
    fields = MapFields(cell_m, place, cols, data, marks, grid_map.floors)
    return msgspec.structs.asdict(fields) | {
        **posed(grid_map.map_from_grid, stamp_ns),
        "cell_size": {"x": cell_m, "y": cell_m},
        "row_stride": cols,
        "cell_stride": 1,
        "fields": [{"name": "occupancy", "offset": 0, "type": _INT8}],
    }


def places(hypotheses: Sequence[Hypothesis], stamp_ns: int) -> Json:
    """Return a `foxglove.SceneUpdate`: an arrow, an ellipse and a percentage for each place."""
    drawn: dict[str, list[Json]] = {"arrows": [], "cylinders": [], "texts": []}
    for place in hypotheses:
        shown = round(0.2 + 0.8 * place.probability, 2)
        rgb = dict(zip("rgb", _COLOURS[place.cluster % len(_COLOURS)], strict=True))
        *sigmas_m, along = ellipse_axes(*(place.covariance[at] for at in (0, 1, 4)))
        long_m, short_m = (round(2 * _SIGMAS * max(m, _MIN_SIGMA_M), 4) for m in sigmas_m)
        x, y, _ = place.pose
        percent = f"{100.0 * place.probability:.0f} %"
        drawn["arrows"].append({"pose": _pose(place.pose), "color": rgb | {"a": shown}, **_ARROW})
        drawn["cylinders"].append(
            {"pose": _pose((x, y, along)), "size": {"x": long_m, "y": short_m, "z": 0.01},
             "bottom_scale": 1, "top_scale": 1, "color": rgb | {"a": shown / 2.0}}
        )  # fmt: skip
        drawn["texts"].append(
            {"pose": _pose((x, y + _TEXT_M, 0.0)), "text": percent, "color": rgb | {"a": 1},
             "font_size": _TEXT_M, "billboard": True, "scale_invariant": False}
        )  # fmt: skip
    nothing = ("metadata", "cubes", "spheres", "lines", "triangles", "models")
    entity = {
        "timestamp": _time(stamp_ns), "frame_id": MAP, **drawn, **{name: [] for name in nothing},
        "id": "places", "lifetime": _time(0), "frame_locked": False,
    }  # fmt: skip
    return {"deletions": [], "entities": [entity]}


def log_line(text: str, stamp_ns: int) -> Json:
    line = {"level": _INFO, "message": text, "name": "coordinator", "file": "", "line": 0}
    return {"timestamp": _time(stamp_ns), **line}


def posed(pose: PoseTuple, stamp_ns: int, frame: str = MAP) -> Json:
    """Return the fields of a `foxglove.PoseInFrame`."""
    return {"timestamp": _time(stamp_ns), "frame_id": frame, "pose": _pose(pose)}


def _time(stamp_ns: int) -> Json:
    sec, nsec = divmod(stamp_ns, 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


def _pose(pose: PoseTuple) -> Json:
    """Return a pose for drawing; rounding to 0.1 mm saves two thirds of the bytes."""
    x, y, heading_rad = pose
    half = heading_rad / 2.0
    turn = {"x": 0, "y": 0, "z": round(math.sin(half), 5), "w": round(math.cos(half), 5)}
    return {"position": {"x": round(x, 4), "y": round(y, 4), "z": 0}, "orientation": turn}
