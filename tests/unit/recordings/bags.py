"""ROS bags that tests make, in every form there is."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from clustermcl.recordings.rigid import Rigid
from clustermcl.ros2.messages_out import pose
from tests.ros_messages import link, new, typestore

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
class Sent:
    """A message of ROS 1 and 2, and when it came."""

    topic: str
    kind: str
    time_ns: int
    message: Any


@cache
def ros1_store() -> Any:
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    return store


def header(stamp_ns: int, frame: str) -> Any:
    """ROS 1's has a field more, which ROS 2 does not look at."""
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    stamp = new("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return ros1_store().types["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id=frame)


def about_z(heading: float) -> tuple[float, float, float, float]:
    return (0.0, 0.0, float(np.sin(heading / 2)), float(np.cos(heading / 2)))


def scan(
    stamp_ns: int,
    ranges: Sequence[float] = (1.0, 2.0, 3.0),
    *,
    frame: str = "laser",
    topic: str = "/scan",
    step: float = 0.5,
    range_max: float = 10.0,
) -> Sent:
    message = new(
        LASER_SCAN,
        header=header(stamp_ns, frame),
        angle_min=-0.25,
        angle_max=-0.25 + step * (len(ranges) - 1),
        angle_increment=step,
        range_min=0.1,
        range_max=range_max,
        ranges=np.array(ranges, np.float32),
    )
    return Sent(topic, LASER_SCAN, stamp_ns, message)


def tf(
    stamp_ns: int,
    parent: str,
    child: str,
    place: Sequence[float] = (0.0, 0.0, 0.0),
    turn: Sequence[float] = LEVEL,
    *,
    topic: str = "/tf",
) -> Sent:
    message = link(parent, child, Rigid(*place, *turn))
    message.transforms[0].header = header(stamp_ns, parent)
    return Sent(topic, TF, stamp_ns, message)


def fixed_tf(
    parent: str, child: str, place: Sequence[float], turn: Sequence[float] = LEVEL
) -> Sent:
    return tf(1, parent, child, place, turn, topic="/tf_static")


def odometry(
    stamp_ns: int, place: Sequence[float], heading: float = 0.0, *, topic: str = "/odom"
) -> Sent:
    message = new(
        ODOMETRY,
        header=header(stamp_ns, "odom"),
        child_frame_id="base_link",
        pose=new("geometry_msgs/msg/PoseWithCovariance", pose=pose((*place[:2], heading))),
    )
    return Sent(topic, ODOMETRY, stamp_ns, message)


def grid(stamp_ns: int, values: Sequence[Sequence[int]], *, topic: str = "/map") -> Sent:
    cells = np.array(values, np.int8)
    rows, cols = cells.shape
    info = new(
        "nav_msgs/msg/MapMetaData",
        resolution=0.05,
        width=cols,
        height=rows,
        origin=pose((-1.0, 2.0, 0.5)),
    )
    message = new(OCCUPANCY_GRID, header=header(stamp_ns, "map"), info=info, data=cells.reshape(-1))
    return Sent(topic, OCCUPANCY_GRID, stamp_ns, message)


def written(folder: Path, form: str, sent: Iterable[Sent], *, encoding: str = "cdr") -> Path:
    """A bag of a form of `FORMS`."""
    name = form.replace(" ", "-")
    storage, *packing = form.split()
    if form in ROS1_FORMS:
        path = folder / f"{name}.bag"
        bag = rosbag1.Writer(path)
        if packing:
            bag.set_compression(rosbag1.Writer.CompressionFormat[packing[0].upper()])
        _fill(bag, ros1_store(), ros1_store().serialize_ros1, sent)
        return path
    path = folder / name
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
    if packing[:1] == ["zstd"]:
        writer.set_compression(_MODES[packing[1]], CompressionFormat.ZSTD)
    _fill(writer, typestore(), typestore().serialize_cdr, sent, serialization_format=encoding)
    match packing:
        case ["bare"]:
            return next(file for file in path.iterdir() if file.name != "metadata.yaml")
        case ["without", "metadata"]:
            (path / "metadata.yaml").unlink()
    return path


def _fill(bag: Any, store: Any, packed: Any, sent: Iterable[Sent], **options: str) -> None:
    connections: dict[str, Any] = {}
    with bag:
        for one in sent:
            if one.topic not in connections:
                connections[one.topic] = bag.add_connection(
                    one.topic, one.kind, typestore=store, **options
                )
            bag.write(connections[one.topic], one.time_ns, bytes(packed(one.message, one.kind)))
