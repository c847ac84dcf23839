"""Reads ROS bags: ROS 1 `.bag`, and rosbag2 in sqlite3 or MCAP, as folders or files.

The library `rosbags` (extra ``ros2``) parses the files. The types read here have the same fields
in all ROS releases, so the library's definitions are used, and those in the bag are ignored.
"""

from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clustermcl.protocol.errors import InputFileError
from clustermcl.recordings.log_file import SkippedLine
from clustermcl.runtime.compressed import most_unpacked

if TYPE_CHECKING:
    from rosbags import rosbag1, rosbag2
    from rosbags.interfaces import Connection
    from rosbags.typesys.store import Typestore

LASER_SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"

_TF_DEFINITION = "geometry_msgs/TransformStamped[] transforms"
_RENAMED = {"tf/msg/tfMessage": TF_MESSAGE}  # name before 2013; the fields are the same
_SUFFIXES = {b"#ROSBAG V": ".bag", b"\x89MCAP0\r\n": ".mcap", b"SQLite format 3\0": ".db3"}
_METADATA = "metadata.yaml"
_FREE_BYTES = 2**26
"""The requested messages of a bag may have these bytes whatever its ratio."""


@dataclass(frozen=True)
class BagMessage:
    """One recorded message of a bag; its number among those requested counts from 1."""

    number: int
    time_ns: int
    topic: str
    content: Any


def is_bag(path: Path) -> bool:
    """Return whether a path is a bag by its first bytes, or a rosbag2 folder."""
    if path.is_dir():
        return (path / _METADATA).is_file() or bool(_storage_files(path))
    return _suffix_of(path) is not None


class BagFile:
    """An open bag: a file, or the folder of a rosbag2.

    Attributes:
        topics: message type of each topic that is not empty.
        left_out: messages that could not be read so far; the last may be the damaged end.

    Raises:
        InputFileError: of the type `error`: the library is missing, or the bag cannot be read.
    """

    def __init__(self, path: Path, error: type[InputFileError]) -> None:
        self._path, self._error = path, error
        self.left_out: list[SkippedLine] = []
        self._reader = self._opened()
        self._connections = [one for one in self._reader.connections if one.msgcount]
        self.topics: Mapping[str, str] = {one.topic: _type_of(one) for one in self._connections}

    def of_type(self, message_type: str) -> list[str]:
        """Return the topics of a message type, sorted by name."""
        return sorted(topic for topic, kind in self.topics.items() if kind == message_type)

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Yield the messages of some topics in the order of recording, up to a damaged end.

        A damaged message is skipped; see `left_out`.

        Raises:
            InputFileError: of the type `error`: the encoding of a topic is not ROS's CDR.
        """
        wanted = [one for one in self._connections if one.topic in topics]
        for connection in wanted:
            encoding = getattr(connection.ext, "serialization_format", "cdr")
            if encoding != "cdr":
                problem = f"{connection.topic} is encoded as {encoding!r:.40}, not as ROS's CDR"
                raise self._error(self._path, problem)
        stream, number = self._reader.messages(wanted) if wanted else iter(()), 0
        left = most_unpacked(self._size, _FREE_BYTES)
        while True:
            number += 1
            try:
                connection, time_ns, content = next(stream)
            except StopIteration:
                return
            except Exception as broken:  # noqa: BLE001 - damaged bytes raise whatever they hit
                self._leave_out(number, "from here on the bag is cut off or damaged", broken)
                return
            if _type_of(connection) != OCCUPANCY_GRID:  # of maps, only the last is kept
                left -= len(content)
            if left < 0:
                raise self._error(self._path, "its scans and odometry are too long unpacked")
            try:
                message = self._decode(content, _type_of(connection))
            except Exception as broken:  # noqa: BLE001 - as above
                self._leave_out(number, f"a message of {connection.topic} is damaged", broken)
            else:
                yield BagMessage(number, time_ns, connection.topic, message)

    def _leave_out(self, number: int, problem: str, broken: Exception) -> None:
        self.left_out.append(SkippedLine(number, f"{problem} ({_problem_of(broken)})"))

    def _opened(self) -> "rosbag1.Reader | rosbag2.Reader":
        try:  # an extra, and 0.2 s
            from rosbags import rosbag1, rosbag2  # noqa: PLC0415

            from clustermcl.recordings.bag_limits import limited  # noqa: PLC0415
        except ImportError as missing:
            problem = "is a ROS bag; to read it, install the extra: pip install 'clustermcl[ros2]'"
            raise self._error(self._path, problem) from missing
        try:
            path = self._readable()
            self._size = sum(one.stat().st_size for one in _storage_files(path) or [path])
            ros1 = _suffix_of(path) == ".bag"
            store = definitions(ros1=ros1)
            self._decode = store.deserialize_ros1 if ros1 else store.deserialize_cdr
            reader = rosbag1.Reader(path) if ros1 else rosbag2.Reader(path)
            with ExitStack() as opened:
                opened.enter_context(limited(path, self._error, self._size))
                reader.open()
                opened.callback(reader.close)
                self.close = opened.pop_all().close
        except InputFileError:
            raise
        except Exception as broken:
            problem = f"cannot be read as a ROS bag: {_problem_of(broken)}"
            remedy = "if it is cut off or damaged, copy it again or repair it by 'rosbag reindex' "
            remedy += "(ROS 1), 'mcap recover', or 'sqlite3 FILE .recover'"
            raise self._error(self._path, f"{problem}; {remedy}") from broken
        return reader

    def _readable(self) -> Path:
        """Return a rosbag2 folder, or a file; of ROS 2, the library reads those with a suffix."""
        path = self._path
        if path.is_dir():
            if (path / _METADATA).is_file():
                return path
            files = _storage_files(path)
            if len(files) > 1:  # a recorder that crashed wrote no metadata
                problem = f"{len(files)} bag files without {_METADATA}; name one, or reindex"
                raise self._error(path, problem)
            path = files[0]
        suffix = _suffix_of(path)
        if suffix is None:
            raise self._error(path, "its content is not a ROS bag")
        if path.suffix != suffix != ".bag":
            raise self._error(path, f"is a bag of ROS 2: give its name the suffix {suffix}")
        return path


@cache
def definitions(*, ros1: bool) -> "Typestore":
    """Return the library's message definitions; loading them takes 0.2 s."""
    from rosbags.typesys import (  # noqa: PLC0415 - an extra
        Stores,
        get_types_from_msg,
        get_typestore,
    )

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    if ros1:  # the library's definitions for ROS 1 lack tf
        store.register(get_types_from_msg(_TF_DEFINITION, TF_MESSAGE))
    return store


def _type_of(connection: "Connection") -> str:
    return _RENAMED.get(connection.msgtype, connection.msgtype)


def _storage_files(path: Path) -> list[Path]:
    """Return the files of a rosbag2 folder; none: it is a file."""
    files = path.iterdir() if path.is_dir() else ()
    return sorted(
        file
        for file in files
        if file.is_file() and file.name.removesuffix(".zstd").endswith((".mcap", ".db3"))
    )


def _suffix_of(path: Path) -> str | None:
    """Return the suffix for a file by its first bytes; None: not a bag."""
    try:
        with path.open("rb") as file:
            start = file.read(max(map(len, _SUFFIXES)))
    except OSError:
        return None
    return next((kind for magic, kind in _SUFFIXES.items() if start.startswith(magic)), None)


def _problem_of(broken: Exception) -> str:
    return str(broken) or type(broken).__name__
