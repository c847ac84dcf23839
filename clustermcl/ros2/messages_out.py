"""The ROS messages that the node publishes."""

import colorsys
import struct
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.poses import between, compose
from clustermcl.protocol.answers import Belief, Hypothesis
from clustermcl.protocol.changes import Changes
from clustermcl.protocol.message import Covariance, PoseTuple, ellipse_axes
from clustermcl.protocol.work import Particles
from clustermcl.recordings.headers import LAST_NS
from clustermcl.recordings.rigid import flat
from clustermcl.ros2 import message_types as types
from clustermcl.ros2.message_types import new

_PLANAR = (0, 1, 5)
"""x, y and heading among the six rows of a ROS covariance."""
CLOUD = 2_000
"""Number of published particles, AMCL's maximum."""
_OK, _WARNING, _ERROR = 0, 1, 2
_COUNT = struct.Struct("<I")
_OF_KIND = (0, 100, 50)
"""Occupancy of what is gone, new, and moving [%]."""
_CDR = b"\x00\x01\x00\x00"
"""Header of each message: plain CDR, little-endian."""
_HEALTHY = ("localized", "ambiguous")


def header(stamp_ns: int, frame: str) -> Any:
    """Return a `std_msgs/Header`; the time is clipped to ROS's range."""
    seconds, nanoseconds = divmod(min(max(stamp_ns, 0), LAST_NS), 1_000_000_000)
    stamp = new("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return new("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def pose(map_from_robot: PoseTuple) -> Any:
    x, y, _, *turn = flat(map_from_robot)
    return new(
        "geometry_msgs/msg/Pose",
        position=new("geometry_msgs/msg/Point", x=x, y=y),
        orientation=_quaternion(turn),
    )


def pose_with_covariance(map_from_robot: PoseTuple, covariance: Covariance) -> Any:
    wide = np.zeros((6, 6))
    wide[np.ix_(_PLANAR, _PLANAR)] = np.reshape(covariance, (3, 3))
    return new(
        "geometry_msgs/msg/PoseWithCovariance",
        pose=pose(map_from_robot),
        covariance=wide.ravel(),
    )


def pose_stamped(
    map_from_robot: PoseTuple, covariance: Covariance, stamp_ns: int, frame: str
) -> Any:
    given = pose_with_covariance(map_from_robot, covariance)
    return new(types.POSE_STAMPED, header=header(stamp_ns, frame), pose=given)


def changes_grid(changes: Changes, frame: str) -> Any:
    """Return a `nav_msgs/OccupancyGrid`: 0 where the map's obstacle is gone, 100 where one is new,
    50 where it moves, and -1 elsewhere. Of a building: of its floors side by side."""
    data = np.full(changes.rows * changes.cols, -1, np.int8)
    cells = changes.cells.array()
    data[cells[:, 0]] = np.array(_OF_KIND, np.int8)[cells[:, 1]]
    info = new(
        "nav_msgs/msg/MapMetaData",
        resolution=changes.cell_m,
        width=changes.cols,
        height=changes.rows,
        origin=pose(changes.map_from_grid),
    )
    stamped = header(changes.stamp_ns, frame)
    return new(types.OCCUPANCY_GRID, header=stamped, info=info, data=data)


def transform(parent_from_child: PoseTuple, stamp_ns: int, parent: str, child: str) -> Any:
    x, y, _, *turn = flat(parent_from_child)
    one = new(
        "geometry_msgs/msg/TransformStamped",
        header=header(stamp_ns, parent),
        child_frame_id=child,
        transform=new(
            "geometry_msgs/msg/Transform",
            translation=new("geometry_msgs/msg/Vector3", x=x, y=y),
            rotation=_quaternion(turn),
        ),
    )
    return new(types.TF_MESSAGE, transforms=[one])


def path(poses: Iterable[PoseTuple], stamp_ns: int, frame: str) -> Any:
    stamped = header(stamp_ns, frame)
    kind = "geometry_msgs/msg/PoseStamped"
    points = [new(kind, header=stamped, pose=pose(one)) for one in poses]
    return new(types.PATH, header=stamped, poses=points)


def detection(belief: Belief, frame: str, node_name: str) -> Any:
    """Return places, probabilities and covariances as a `vision_msgs/Detection3D` of the robot.

    Each place is a result: `class_id` is the cluster's number, `score` its probability.
    """
    results = [
        new(
            "vision_msgs/msg/ObjectHypothesisWithPose",
            hypothesis=new(
                "vision_msgs/msg/ObjectHypothesis",
                class_id=str(one.cluster),
                score=one.probability,
            ),
            pose=pose_with_covariance(one.pose, one.covariance),
        )
        for one in belief.hypotheses
    ]
    stamped = header(belief.stamp_ns, frame)
    return new(types.DETECTION, header=stamped, results=results, id=node_name)


def mixed(
    belief: Belief, of_clusters: Mapping[int, Particles]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Sample the particles of all clusters by probability, moved by odometry to the belief.

    Returns:
        (N, 3) poses and (N,) weights that sum to one; None while no particles are known.
    """
    places = [place for place in belief.hypotheses if place.cluster in of_clusters]
    total = sum(place.probability for place in places)
    if total <= 0.0:
        return None
    odometry, poses, weights = np.array(belief.odom_from_robot), [], []
    for place in places:
        particles, count = of_clusters[place.cluster], max(1, round(CLOUD * place.probability))
        since = between(np.array(particles.odom_from_robot), odometry)
        moved = compose(particles.resampled(count), since)
        if belief.floors:  # particles are in the atlas, places on their floor
            moved[:, :2] += np.array(place.pose[:2]) - moved[:, :2].mean(axis=0)
        poses.append(moved)
        weights.append(np.full(count, place.probability / total / count))
    return np.concatenate(poses), np.concatenate(weights)


def particle_cloud(
    map_from_robot: NDArray[np.float64], weights: NDArray[np.float64], stamp_ns: int, frame: str
) -> bytes:
    """Encode (N, 3) poses and (N,) weights that sum to one as a `nav2_msgs/ParticleCloud`.

    This is a hundred times faster than the general encoder.
    """
    rows = np.zeros((len(weights), 8))
    rows[:, :2] = map_from_robot[:, :2]
    rows[:, 5], rows[:, 6] = np.sin(map_from_robot[:, 2] / 2), np.cos(map_from_robot[:, 2] / 2)
    rows[:, 7] = weights
    stamp, name = header(stamp_ns, frame).stamp, frame.encode() + b"\0"
    start = struct.pack("<iII", stamp.sec, stamp.nanosec, len(name)) + name
    start += bytes(-len(start) % _COUNT.size) + _COUNT.pack(len(rows))
    aligned = bytes(-len(start) % rows.itemsize) if len(rows) else b""
    return _CDR + start + aligned + rows.astype("<f8").tobytes()


def diagnostics(
    belief_state: str, freshness: str, values: Mapping[str, object], node_name: str, stamp_ns: int
) -> Any:
    level = _OK if freshness == "fresh" and belief_state in _HEALTHY else _WARNING
    if freshness in ("unreachable", "stale"):
        level = _ERROR
    status = new(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=level,
        name=f"{node_name}: localization",
        message=f"{belief_state}, {freshness}",
        hardware_id="clustermcl",
        values=[
            new("diagnostic_msgs/msg/KeyValue", key=key, value=str(value))
            for key, value in values.items()
        ],
    )
    return new(types.DIAGNOSTIC_ARRAY, header=header(stamp_ns, ""), status=[status])


def _quaternion(parts: Iterable[float]) -> Any:
    x, y, z, w = parts
    return new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


MOST_DRAWN = 50
"""Limit for the number of drawn places; more are not distinguishable."""

_ARROW, _CYLINDER, _TEXT = 0, 3, 9
_DELETE_ALL = 3
_ARROW_M, _ARROW_WIDTH_M = 0.8, 0.1
_SIGMAS = 2.0
_LEAST_M, _HEIGHT_M, _TEXT_ABOVE_M, _TEXT_M = 0.05, 0.02, 0.5, 0.4
_GOLDEN_RATIO = 0.618034
"""Hues in steps of it are well separated."""


def markers(belief: Belief, frame: str) -> Any:
    """Return a `visualization_msgs/MarkerArray`: arrow, ellipse and percentage of each place."""
    shared = header(belief.stamp_ns, frame)
    clean = new("visualization_msgs/msg/Marker", header=shared, action=_DELETE_ALL)
    drawn = [
        marker
        for hypothesis in belief.hypotheses[:MOST_DRAWN]
        for marker in _place(hypothesis, shared)
    ]
    return new(types.MARKER_ARRAY, markers=[clean, *drawn])


def _place(place: Hypothesis, shared: Any) -> tuple[Any, Any, Any]:
    x, y, _ = place.pose
    *sigmas_m, direction_rad = ellipse_axes(*(place.covariance[at] for at in (0, 1, 4)))
    long_m, short_m = (max(2.0 * _SIGMAS * sigma_m, _LEAST_M) for sigma_m in sigmas_m)
    red, green, blue = colorsys.hsv_to_rgb(place.cluster * _GOLDEN_RATIO % 1.0, 0.9, 0.9)

    def marker(
        name: str, kind: int, at: PoseTuple, scale: tuple[float, float, float], alpha: float
    ) -> Any:
        return new(
            "visualization_msgs/msg/Marker",
            header=shared,
            ns=name,
            id=place.cluster % 2**31,
            type=kind,
            pose=pose(at),
            scale=new("geometry_msgs/msg/Vector3", **dict(zip("xyz", scale, strict=True))),
            color=new("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=alpha),
        )

    alpha = 0.3 + 0.7 * place.probability
    arrow_m, ellipse_m = (_ARROW_M, _ARROW_WIDTH_M, _ARROW_WIDTH_M), (long_m, short_m, _HEIGHT_M)
    arrow = marker("arrow", _ARROW, place.pose, arrow_m, alpha)
    ellipse = marker("ellipse", _CYLINDER, (x, y, direction_rad), ellipse_m, alpha)
    percentage = marker("percentage", _TEXT, (x, y, 0.0), (0.0, 0.0, _TEXT_M), 1.0)
    percentage.pose.position.z = _TEXT_ABOVE_M
    percentage.text = f"{100.0 * place.probability:.0f} %"
    return arrow, ellipse, percentage
