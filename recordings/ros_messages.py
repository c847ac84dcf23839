"""What a run is made of, as ROS messages."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from grid_maps.grid_map import GridMap
from particle_filter.arrays import OCCUPIED
from protocol.answers import Belief, Hypothesis
from protocol.message import Covariance, PoseTuple
from protocol.pose_arrays import covariance_matrix
from protocol.steps import LaserBeams, Scan

MAP, ODOM, BASE, LASER = "map", "odom", "base_link", "laser"
"""Frames."""
BELIEF_TOPIC = "/belief"
_SIGMAS = 2.0
"""An ellipse holds 86 % of a place."""
_MIN_SIGMA_M = 0.02
_ARROW_M, _TEXT_M = 0.6, 0.3
_COLOURS = (
    (0.12, 0.47, 0.71), (1.0, 0.5, 0.05), (0.17, 0.63, 0.17), (0.84, 0.15, 0.16),
    (0.58, 0.4, 0.74), (0.55, 0.34, 0.29), (0.89, 0.47, 0.76), (0.09, 0.75, 0.81),
)  # fmt: skip
"""Of places, by the number of their cluster."""


class RosMessages:
    """Makes messages.

    Args:
        types: the classes, by the messages' names.
    """

    def __init__(self, types: Mapping[str, Any]) -> None:
        self._types = types

    def scan(self, beams: Scan | LaserBeams, stamp_ns: int, frame: str) -> Any:
        """A `LaserScan`; what is no return is infinite."""
        ranges = np.array(beams.ranges.array(), np.float32)
        with np.errstate(invalid="ignore"):
            ranges[~((ranges > 0.0) & (ranges < beams.range_max_m))] = np.inf
        return self._types["sensor_msgs/msg/LaserScan"](
            header=self._header(stamp_ns, frame),
            angle_min=beams.angle_min_rad,
            angle_max=beams.angle_min_rad + beams.angle_step_rad * (len(ranges) - 1),
            angle_increment=beams.angle_step_rad,
            time_increment=0.0,
            scan_time=0.0,
            range_min=0.0,
            range_max=beams.range_max_m,
            ranges=ranges,
            intensities=np.empty(0, np.float32),
        )

    def transforms(self, stamp_ns: int, *links: tuple[str, str, PoseTuple]) -> Any:
        """A message of tf.

        Args:
            stamp_ns: when.
            links: parent, child, and pose of the child in the parent.
        """
        made = [
            self._types["geometry_msgs/msg/TransformStamped"](
                header=self._header(stamp_ns, parent),
                child_frame_id=child,
                transform=self._types["geometry_msgs/msg/Transform"](
                    translation=self._types["geometry_msgs/msg/Vector3"](pose[0], pose[1], 0.0),
                    rotation=self._turn(pose[2]),
                ),
            )
            for parent, child, pose in links
        ]
        return self._types["tf2_msgs/msg/TFMessage"](transforms=made)

    def map(self, grid_map: GridMap, stamp_ns: int) -> Any:
        """An `OccupancyGrid`."""
        rows, cols = grid_map.cells.shape
        occupancy = np.where(grid_map.cells == OCCUPIED, 100, grid_map.cells)
        meta = self._types["nav_msgs/msg/MapMetaData"](
            map_load_time=self._time(stamp_ns),
            resolution=grid_map.cell_m,
            width=cols,
            height=rows,
            origin=self._pose(grid_map.map_from_grid),
        )
        return self._types["nav_msgs/msg/OccupancyGrid"](
            header=self._header(stamp_ns, MAP),
            info=meta,
            data=occupancy.astype(np.int8).ravel(),
        )

    def pose(self, mean: PoseTuple, covariance: Covariance, stamp_ns: int) -> Any:
        """A `PoseWithCovarianceStamped` in the map."""
        six = np.zeros((6, 6))
        six[np.ix_((0, 1, 5), (0, 1, 5))] = covariance_matrix(covariance)
        return self._types["geometry_msgs/msg/PoseWithCovarianceStamped"](
            header=self._header(stamp_ns, MAP),
            pose=self._types["geometry_msgs/msg/PoseWithCovariance"](
                pose=self._pose(mean), covariance=six.ravel()
            ),
        )

    def poses(self, poses: Iterable[PoseTuple], stamp_ns: int) -> Any:
        """A `PoseArray` in the map."""
        return self._types["geometry_msgs/msg/PoseArray"](
            header=self._header(stamp_ns, MAP), poses=[self._pose(pose) for pose in poses]
        )

    def belief(self, belief: Belief) -> Any:
        """A `String` that holds all of a belief, as JSON."""
        return self._types["std_msgs/msg/String"](data=msgspec.json.encode(belief).decode())

    def places(self, hypotheses: Sequence[Hypothesis], stamp_ns: int) -> Any:
        """A `MarkerArray`: of each place an arrow, an ellipse and its percentage."""
        markers = [self._marker(stamp_ns, action=3)]  # whatever was drawn before goes
        for place in hypotheses:
            markers += self._place(place, stamp_ns)
        return self._types["visualization_msgs/msg/MarkerArray"](markers=markers)

    def _place(self, place: Hypothesis, stamp_ns: int) -> list[Any]:
        colour, number = _COLOURS[place.cluster % len(_COLOURS)], place.cluster
        x, y, _ = place.mean
        spread = covariance_matrix(place.covariance)[:2, :2]
        variances, axes = np.linalg.eigh(spread)
        long_m, short_m = (
            2.0 * _SIGMAS * max(math.sqrt(max(float(variance), 0.0)), _MIN_SIGMA_M)
            for variance in variances[::-1]
        )
        along = math.atan2(float(axes[1, 1]), float(axes[0, 1]))
        shown = 0.2 + 0.8 * place.probability
        return [
            self._marker(
                stamp_ns, ns="arrow", type=0, pose=place.mean, scale=(_ARROW_M, 0.08, 0.08),
                colour=(*colour, shown), id=number,
            ),
            self._marker(
                stamp_ns, ns="ellipse", type=3, pose=(x, y, along), scale=(long_m, short_m, 0.01),
                colour=(*colour, 0.5 * shown), id=number,
            ),
            self._marker(
                stamp_ns, ns="probability", type=9, pose=(x, y + _TEXT_M, 0.0),
                scale=(0.0, 0.0, _TEXT_M), colour=(*colour, 1.0),
                text=f"{100.0 * place.probability:.0f} %", id=number,
            ),
        ]  # fmt: skip

    def _marker(
        self,
        stamp_ns: int,
        *,
        ns: str = "",
        id: int = 0,  # noqa: A002 - as the message has it
        type: int = 0,  # noqa: A002 - as the message has it
        action: int = 0,
        pose: PoseTuple = (0.0, 0.0, 0.0),
        scale: tuple[float, float, float] = (0.0, 0.0, 0.0),
        colour: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0),
        text: str = "",
    ) -> Any:
        types = self._types
        return types["visualization_msgs/msg/Marker"](
            header=self._header(stamp_ns, MAP),
            ns=ns,
            id=id,
            type=type,
            action=action,
            pose=self._pose(pose),
            scale=types["geometry_msgs/msg/Vector3"](*scale),
            color=types["std_msgs/msg/ColorRGBA"](*colour),
            lifetime=types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0),
            frame_locked=False,
            points=[],
            colors=[],
            texture_resource="",
            texture=types["sensor_msgs/msg/CompressedImage"](
                header=self._header(0, ""), format="", data=np.empty(0, np.uint8)
            ),
            uv_coordinates=[],
            text=text,
            mesh_resource="",
            mesh_file=types["visualization_msgs/msg/MeshFile"](
                filename="", data=np.empty(0, np.uint8)
            ),
            mesh_use_embedded_materials=False,
        )

    def _header(self, stamp_ns: int, frame: str) -> Any:
        return self._types["std_msgs/msg/Header"](stamp=self._time(stamp_ns), frame_id=frame)

    def _time(self, stamp_ns: int) -> Any:
        sec, nanosec = divmod(stamp_ns, 1_000_000_000)
        return self._types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)

    def _pose(self, pose: PoseTuple) -> Any:
        return self._types["geometry_msgs/msg/Pose"](
            position=self._types["geometry_msgs/msg/Point"](pose[0], pose[1], 0.0),
            orientation=self._turn(pose[2]),
        )

    def _turn(self, heading_rad: float) -> Any:
        half = heading_rad / 2.0
        return self._types["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(half), math.cos(half))
