"""ROS bags that tests make, in every form there is."""

import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

LASER_SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"
TF = "tf2_msgs/msg/TFMessage"

LEVEL = (0.0, 0.0, 0.0, 1.0)
ROLLED_OVER = (1.0, 0.0, 0.0, 0.0)

ROS1_FORMS = ("ros1", "ros1 bz2", "ros1 lz4")
ROS2_FORMS = (
    *("sqlite3", "sqlite3 zstd file", "sqlite3 zstd message", "sqlite3 bare"),
    *("mcap", "mcap zstd file", "mcap zstd message", "mcap zstd storage", "mcap bare"),
    "mcap without metadata",
)
FORMS = (*ROS1_FORMS, *ROS2_FORMS)

_MODES = {
    "file": CompressionMode.FILE,
    "message": CompressionMode.MESSAGE,
    "storage": CompressionMode.STORAGE,
}


@dataclass(frozen=True)
class Types:
    """Classes of messages, of ROS 1 or of ROS 2."""

    store: Any

    def make(self, kind: str, **fields: object) -> Any:
        return self.store.types[kind](**fields)

    def stamp(self, stamp_ns: int) -> Any:
        sec, nanosec = divmod(stamp_ns, 1_000_000_000)
        return self.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)

    def header(self, stamp_ns: int, frame: str) -> Any:
        kind = "std_msgs/msg/Header"
        fields: dict[str, object] = {"stamp": self.stamp(stamp_ns), "frame_id": frame}
        if any(name == "seq" for name, _ in self.store.fielddefs[kind][1]):
            fields["seq"] = 0
        return self.make(kind, **fields)

    def vector(self, kind: str, values: Sequence[float]) -> Any:
        return self.make(f"geometry_msgs/msg/{kind}", **dict(zip("xyzw", values, strict=False)))

    def pose(self, place: Sequence[float], turn: Sequence[float]) -> Any:
        position, orientation = self.vector("Point", place), self.vector("Quaternion", turn)
        return self.make("geometry_msgs/msg/Pose", position=position, orientation=orientation)


@dataclass(frozen=True)
class Sent:
    """A message, how it is made for ROS 1 or 2, and when it came."""

    topic: str
    kind: str
    time_ns: int
    content: Callable[[Types], Any]


def about_z(heading: float) -> tuple[float, float, float, float]:
    return (0.0, 0.0, float(np.sin(heading / 2)), float(np.cos(heading / 2)))


def scan(
    stamp_ns: int,
    ranges: Sequence[float] = (1.0, 2.0, 3.0),
    *,
    frame: str = "laser",
    topic: str = "/scan",
    step: float = 0.5,
    range_min: float = 0.1,
    range_max: float = 10.0,
) -> Sent:
    def made(types: Types) -> Any:
        return types.make(
            LASER_SCAN,
            header=types.header(stamp_ns, frame),
            angle_min=-0.25,
            angle_max=-0.25 + step * (len(ranges) - 1),
            angle_increment=step,
            time_increment=0.0,
            scan_time=0.0,
            range_min=range_min,
            range_max=range_max,
            ranges=np.array(ranges, np.float32),
            intensities=np.zeros(0, np.float32),
        )

    return Sent(topic, LASER_SCAN, stamp_ns, made)


def tf(
    stamp_ns: int,
    parent: str,
    child: str,
    place: Sequence[float] = (0.0, 0.0, 0.0),
    turn: Sequence[float] = LEVEL,
    *,
    topic: str = "/tf",
) -> Sent:
    def made(types: Types) -> Any:
        transform = types.make(
            "geometry_msgs/msg/Transform",
            translation=types.vector("Vector3", place),
            rotation=types.vector("Quaternion", turn),
        )
        one = types.make(
            "geometry_msgs/msg/TransformStamped",
            header=types.header(stamp_ns, parent),
            child_frame_id=child,
            transform=transform,
        )
        return types.make(TF, transforms=[one])

    return Sent(topic, TF, stamp_ns, made)


def fixed_tf(
    parent: str, child: str, place: Sequence[float], turn: Sequence[float] = LEVEL
) -> Sent:
    return tf(1, parent, child, place, turn, topic="/tf_static")


def odometry(
    stamp_ns: int, place: Sequence[float], heading: float = 0.0, *, topic: str = "/odom"
) -> Sent:
    def made(types: Types) -> Any:
        still = types.make(
            "geometry_msgs/msg/Twist",
            linear=types.vector("Vector3", (0.0, 0.0, 0.0)),
            angular=types.vector("Vector3", (0.0, 0.0, 0.0)),
        )
        nothing = np.zeros(36)
        return types.make(
            ODOMETRY,
            header=types.header(stamp_ns, "odom"),
            child_frame_id="base_link",
            pose=types.make(
                "geometry_msgs/msg/PoseWithCovariance",
                pose=types.pose(place, about_z(heading)),
                covariance=nothing,
            ),
            twist=types.make(
                "geometry_msgs/msg/TwistWithCovariance", twist=still, covariance=nothing
            ),
        )

    return Sent(topic, ODOMETRY, stamp_ns, made)


def grid(
    stamp_ns: int, values: Sequence[Sequence[int]], *, topic: str = "/map", cell_m: float = 0.05
) -> Sent:
    cells = np.array(values, np.int8)

    def made(types: Types) -> Any:
        rows, cols = cells.shape
        info = types.make(
            "nav_msgs/msg/MapMetaData",
            map_load_time=types.stamp(0),
            resolution=cell_m,
            width=cols,
            height=rows,
            origin=types.pose((-1.0, 2.0, 0.0), about_z(0.5)),
        )
        header = types.header(stamp_ns, "map")
        return types.make(OCCUPANCY_GRID, header=header, info=info, data=cells.reshape(-1))

    return Sent(topic, OCCUPANCY_GRID, stamp_ns, made)


@cache
def ros2_types() -> Types:
    return Types(get_typestore(Stores.ROS2_HUMBLE))


@cache
def ros1_types() -> Types:
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    return Types(store)


def written(folder: Path, form: str, sent: Iterable[Sent], *, encoding: str = "cdr") -> Path:
    """A bag of a form of `FORMS`."""
    name = form.replace(" ", "-")
    if form in ROS1_FORMS:
        return _ros1(folder / f"{name}.bag", form.partition(" ")[2], sent)
    storage, *packing = form.split()
    path = folder / name
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
    if packing[:1] == ["zstd"]:
        writer.set_compression(_MODES[packing[1]], CompressionFormat.ZSTD)
    types = ros2_types()
    with writer:
        connections: dict[str, Any] = {}
        for one in sent:
            if one.topic not in connections:
                connections[one.topic] = writer.add_connection(
                    one.topic, one.kind, typestore=types.store, serialization_format=encoding
                )
            content = types.store.serialize_cdr(one.content(types), one.kind)
            writer.write(connections[one.topic], one.time_ns, content)
    match packing:
        case ["bare"]:
            return next(file for file in path.iterdir() if file.name != "metadata.yaml")
        case ["without", "metadata"]:
            (path / "metadata.yaml").unlink()
    return path


def _ros1(path: Path, packing: str, sent: Iterable[Sent]) -> Path:
    types = ros1_types()
    writer = rosbag1.Writer(path)
    if packing:
        writer.set_compression(rosbag1.Writer.CompressionFormat[packing.upper()])
    with writer:
        connections: dict[str, Any] = {}
        for one in sent:
            if one.topic not in connections:
                connections[one.topic] = writer.add_connection(
                    one.topic, one.kind, typestore=types.store
                )
            content = types.store.serialize_ros1(one.content(types), one.kind)
            writer.write(connections[one.topic], one.time_ns, bytes(content))
    return path


def copy_of_first_bytes(path: Path, folder: Path, share: float) -> Path:
    """The bag, of which only the first bytes were copied."""
    cut = folder / path.name
    shutil.copyfile(path, cut)
    with cut.open("r+b") as file:
        file.truncate(int(path.stat().st_size * share))
    return cut
