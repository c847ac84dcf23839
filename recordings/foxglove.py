"""What a run log draws: messages that Foxglove knows by the names of their schemas.

Fields are those of https://docs.foxglove.dev/docs/sdk/schemas, as JSON. A few fields of our own
keep what a playback needs; Foxglove ignores them.
"""

import math
from collections.abc import Sequence
from typing import Annotated, TypeAlias, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from grid_maps.grid_map import GridMap
from grid_maps.map_message import cells_of
from particle_filter.arrays import OCCUPIED
from protocol.answers import Hypothesis
from protocol.arrays import ArrayBlob
from protocol.message import Covariance, PoseTuple
from protocol.steps import LaserBeams, Scan

MAP, ODOM, BASE = "map", "odom", "base_link"
"""Frames, as ROS calls them (REP 105)."""
_INT8, _INFO = 2, 2
_DIGITS = 4
"""What is only drawn is rounded to 0.1 mm: a third of the bytes."""
_SIGMAS = 2.0
"""An ellipse of two standard deviations holds 86 % of a Gaussian in the plane."""
_MIN_SIGMA_M = 0.02
_ARROW_M, _TEXT_M = 0.6, 0.3
_COLOURS = (
    (0.12, 0.47, 0.71), (1.0, 0.5, 0.05), (0.17, 0.63, 0.17), (0.84, 0.15, 0.16),
    (0.58, 0.4, 0.74), (0.55, 0.34, 0.29), (0.89, 0.47, 0.76), (0.09, 0.75, 0.81),
)  # fmt: skip
"""Of places, by the number of their cluster."""

Planar: TypeAlias = Annotated[tuple[float, ...], msgspec.Meta(min_length=3, max_length=3)]
"""x [m], y [m], heading [rad]; Foxglove's parser of schemas refuses the type `PoseTuple`."""


class Time(msgspec.Struct, frozen=True):
    """Since the robot's epoch."""

    sec: int
    nsec: int

    @classmethod
    def of(cls, stamp_ns: int) -> "Time":
        return cls(*divmod(stamp_ns, 1_000_000_000))

    @property
    def ns(self) -> int:
        return self.sec * 1_000_000_000 + self.nsec


class Vector3(msgspec.Struct, frozen=True):
    """A point or a size [m]."""

    x: float
    y: float
    z: float = 0.0

    @classmethod
    def of(cls, pose: Sequence[float]) -> "Vector3":
        return cls(round(pose[0], _DIGITS), round(pose[1], _DIGITS))


class Quaternion(msgspec.Struct, frozen=True):
    """A turn about the vertical axis."""

    x: float
    y: float
    z: float
    w: float

    @classmethod
    def of(cls, heading_rad: float) -> "Quaternion":
        half = heading_rad / 2.0
        return cls(0.0, 0.0, round(math.sin(half), 5), round(math.cos(half), 5))


class Pose(msgspec.Struct, frozen=True):
    """A pose in the plane."""

    position: Vector3
    orientation: Quaternion

    @classmethod
    def of(cls, pose: PoseTuple) -> "Pose":
        return cls(Vector3.of(pose), Quaternion.of(pose[2]))


class Color(msgspec.Struct, frozen=True):
    """Each from 0 to 1."""

    r: float
    g: float
    b: float
    a: float


class Drawn(msgspec.Struct, frozen=True, kw_only=True):
    """A message that Foxglove knows."""

    timestamp: Time


class FrameTransform(Drawn, frozen=True, kw_only=True):
    """Where a frame is in its parent."""

    parent_frame_id: str
    child_frame_id: str
    translation: Vector3
    rotation: Quaternion
    parent_from_child: Planar
    """The same, to the last bit."""

    @classmethod
    def of(cls, stamp_ns: int, parent: str, child: str, pose: PoseTuple) -> "FrameTransform":
        return cls(
            timestamp=Time.of(stamp_ns),
            parent_frame_id=parent,
            child_frame_id=child,
            translation=Vector3.of(pose),
            rotation=Quaternion.of(pose[2]),
            parent_from_child=pose,
        )


class LaserScan(Drawn, frozen=True, kw_only=True):
    """What one laser measured for a step; a range of 0 is no return."""

    frame_id: str
    pose: Pose
    """Of the laser on the robot."""
    start_angle: float
    end_angle: float
    ranges: list[float]
    intensities: list[float] = msgspec.field(default_factory=list)
    step: int
    angle_step_rad: float
    range_max_m: float
    robot_from_laser: Planar
    odom_from_robot: Planar
    map_digest: str

    @classmethod
    def of(cls, scan: Scan, beams: Scan | LaserBeams) -> "LaserScan":
        """The beams of one laser of a step."""
        ranges = beams.ranges.array().astype(np.float64)
        with np.errstate(invalid="ignore"):
            ranges[~((ranges > 0.0) & (ranges < beams.range_max_m))] = 0.0
        return cls(
            timestamp=Time.of(scan.stamp_ns),
            frame_id=BASE,
            pose=Pose.of(beams.robot_from_laser),
            start_angle=beams.angle_min_rad,
            end_angle=beams.angle_min_rad + beams.angle_step_rad * (len(ranges) - 1),
            ranges=_short(ranges).tolist(),
            step=scan.step,
            angle_step_rad=beams.angle_step_rad,
            range_max_m=beams.range_max_m,
            robot_from_laser=beams.robot_from_laser,
            odom_from_robot=scan.odom_from_robot,
            map_digest=scan.map_digest,
        )

    def beams(self) -> LaserBeams:
        """The measurement again."""
        return LaserBeams(
            robot_from_laser=cast(PoseTuple, self.robot_from_laser),
            angle_min_rad=self.start_angle,
            angle_step_rad=self.angle_step_rad,
            range_max_m=self.range_max_m,
            ranges=ArrayBlob.of(np.array(self.ranges), "float32"),
        )


def _short(ranges: NDArray[np.float64]) -> NDArray[np.float64]:
    """The shortest decimals that are the same in 32 bits, where 0.1 mm are enough for that."""
    rounded = np.round(ranges, _DIGITS)
    return np.where(rounded.astype(np.float32) == ranges, rounded, ranges)


class Vector2(msgspec.Struct, frozen=True):
    """A size [m]."""

    x: float
    y: float


class PackedField(msgspec.Struct, frozen=True):
    """What a byte of a cell is."""

    name: str
    offset: int
    type: int


class Grid(Drawn, frozen=True, kw_only=True):
    """The map, as ROS has it: 0 is free, 100 occupied, -1 unknown."""

    frame_id: str = MAP
    pose: Pose
    column_count: int
    cell_size: Vector2
    row_stride: int
    cell_stride: int = 1
    fields: tuple[PackedField, ...] = (PackedField("occupancy", 0, _INT8),)
    data: bytes
    map_from_grid: Planar

    @classmethod
    def of(cls, grid_map: GridMap, stamp_ns: int, max_cells: int) -> "Grid":
        """A map of at most `max_cells`: of cells that become one, walls win, then free ones."""
        cells, every = grid_map.cells, math.ceil(math.sqrt(grid_map.cells.size / max_cells))
        for axis in range(2 if every > 1 else 0):
            first = np.arange(0, cells.shape[axis], every)
            cells = np.maximum.reduceat(cells, first, axis=axis)
        cell_m = grid_map.cell_m * every
        return cls(
            timestamp=Time.of(stamp_ns),
            pose=Pose.of(grid_map.map_from_grid),
            column_count=cells.shape[1],
            cell_size=Vector2(cell_m, cell_m),
            row_stride=cells.shape[1],
            data=np.where(cells == OCCUPIED, 100, cells).astype(np.int8).tobytes(),
            map_from_grid=grid_map.map_from_grid,
        )

    def grid_map(self) -> GridMap:
        """The map again.

        Raises:
            ValueError: the bytes are no map.
        """
        occupancy = np.frombuffer(self.data, np.int8).reshape(-1, max(self.column_count, 1))
        pose = cast(PoseTuple, self.map_from_grid)
        return GridMap(cells_of(occupancy), self.cell_size.x, pose)


class PoseInFrame(Drawn, frozen=True, kw_only=True):
    """The most probable place."""

    frame_id: str = MAP
    pose: Pose

    @classmethod
    def of(cls, map_from_robot: PoseTuple, stamp_ns: int) -> "PoseInFrame":
        return cls(timestamp=Time.of(stamp_ns), pose=Pose.of(map_from_robot))


class Arrow(msgspec.Struct, frozen=True, kw_only=True):
    """Where a place looks."""

    pose: Pose
    shaft_length: float = _ARROW_M
    shaft_diameter: float = 0.08
    head_length: float = 0.15
    head_diameter: float = 0.16
    color: Color


class Cylinder(msgspec.Struct, frozen=True, kw_only=True):
    """A place's ellipse."""

    pose: Pose
    size: Vector3
    bottom_scale: float = 1.0
    top_scale: float = 1.0
    color: Color


class Text(msgspec.Struct, frozen=True, kw_only=True):
    """A place's percentage."""

    pose: Pose
    billboard: bool = True
    font_size: float = _TEXT_M
    scale_invariant: bool = False
    color: Color
    text: str


class SceneEntity(msgspec.Struct, frozen=True, kw_only=True):
    """All places; each belief replaces those of the one before."""

    timestamp: Time
    frame_id: str = MAP
    id: str = "places"
    lifetime: Time = Time(0, 0)
    frame_locked: bool = False
    metadata: tuple[float, ...] = ()
    arrows: list[Arrow]
    cubes: tuple[float, ...] = ()
    spheres: tuple[float, ...] = ()
    cylinders: list[Cylinder]
    lines: tuple[float, ...] = ()
    triangles: tuple[float, ...] = ()
    texts: list[Text]
    models: tuple[float, ...] = ()


class SceneUpdate(msgspec.Struct, frozen=True, kw_only=True):
    """Of each place an arrow, an ellipse of two standard deviations and its percentage."""

    deletions: tuple[float, ...] = ()
    entities: list[SceneEntity]

    @classmethod
    def of(cls, hypotheses: Sequence[Hypothesis], stamp_ns: int) -> "SceneUpdate":
        arrows, cylinders, texts = list[Arrow](), list[Cylinder](), list[Text]()
        for place in hypotheses:
            colour = _COLOURS[place.cluster % len(_COLOURS)]
            shown = round(0.2 + 0.8 * place.probability, 2)
            along, long_m, short_m = _ellipse(place.covariance)
            x, y, _ = place.mean
            arrows.append(Arrow(pose=Pose.of(place.mean), color=Color(*colour, shown)))
            cylinders.append(
                Cylinder(
                    pose=Pose.of((x, y, along)),
                    size=msgspec.structs.replace(Vector3.of((long_m, short_m)), z=0.01),
                    color=Color(*colour, shown / 2.0),
                )
            )
            texts.append(
                Text(
                    pose=Pose.of((x, y + _TEXT_M, 0.0)),
                    color=Color(*colour, 1.0),
                    text=f"{100.0 * place.probability:.0f} %",
                )
            )
        entity = SceneEntity(
            timestamp=Time.of(stamp_ns), arrows=arrows, cylinders=cylinders, texts=texts
        )
        return cls(entities=[entity])


def _ellipse(covariance: Covariance) -> tuple[float, float, float]:
    """Direction of the long axis [rad], and both diameters [m], of a pose's covariance."""
    xx, xy, yy = covariance[0], covariance[1], covariance[4]
    middle, apart = (xx + yy) / 2.0, math.hypot((xx - yy) / 2.0, xy)
    long_m, short_m = (
        2.0 * _SIGMAS * max(math.sqrt(max(variance, 0.0)), _MIN_SIGMA_M)
        for variance in (middle + apart, middle - apart)
    )
    return 0.5 * math.atan2(2.0 * xy, xx - yy), long_m, short_m


class Log(Drawn, frozen=True, kw_only=True):
    """A line of text."""

    level: int = _INFO
    message: str
    name: str
    file: str = ""
    line: int = 0

    @classmethod
    def of(cls, text: str, stamp_ns: int) -> "Log":
        return cls(timestamp=Time.of(stamp_ns), message=text, name="coordinator")
