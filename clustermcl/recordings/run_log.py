"""Reads and writes run logs, MCAP files of the flight recorder.

Messages are JSON, or MessagePack if only a replay reads them. docs/recordings.md lists all topics.
"""

import os
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Literal, NamedTuple, TypeVar

import msgspec
import numpy as np
from mcap.records import Channel, Header, Message

from clustermcl.filter.poses import compose, inverse
from clustermcl.protocol import conversion
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.errors import RecordingError
from clustermcl.protocol.floors import ONE_MAP
from clustermcl.protocol.pose_arrays import pose_tuple
from clustermcl.protocol.steps import LaserReading, Scan
from clustermcl.protocol.validity import problem_of
from clustermcl.recordings import foxglove
from clustermcl.recordings.bag_chunks import mcap_records
from clustermcl.recordings.foxglove import BASE, MAP, ODOM
from clustermcl.recordings.log_file import SENDER, Entry, SkippedLine, odometry_entry
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.runtime.compressed import most_unpacked, os_problem
from clustermcl.runtime.output_files import OutputError

PROFILE = "clustermcl"
"""Profile in the header of each run log; a file with another profile is refused."""
SCAN, ODOMETRY, GRID, POSE, PLACES = "/scan", "/tf", "/map", "/pose", "/places"
"""Topics that Foxglove draws; the second laser of a step is on `/scan_1`, and so on."""
BELIEF, JOB_EVENTS, LINES = "/belief", "/events", "/log"
SCHEMAS = {
    SCAN: "foxglove.LaserScan", ODOMETRY: "foxglove.FrameTransform", GRID: "foxglove.Grid",
    POSE: "foxglove.PoseInFrame", PLACES: "foxglove.SceneUpdate", LINES: "foxglove.Log",
}  # fmt: skip
_MAGIC = b"\x89MCAP0\r\n"
_BASE64 = {"type": "string", "contentEncoding": "base64"}
_JSON_SCHEMA = msgspec.json.encode({"type": "object", "properties": {"data": _BASE64}})
"""Schema that marks the base64 strings; Foxglove knows the other fields by name."""
CHUNK_BYTES = 2**18
MAX_MAP_CELLS = 4_000_000
"""A larger map is recorded at a lower resolution, because each file begins with the map."""
MAX_MESSAGE_BYTES = 2**22
"""Limit for a message other than a map [bytes]; decoding takes fifty times this memory."""
MAX_PLAYBACK_BYTES = 2**31
"""Limit for scans and odometry of a run that is played back [bytes]: about 30 hours."""
_FREE_PLAYBACK_BYTES = 2**25
"""A file may have these bytes of them whatever its ratio."""


class RunLog:
    """Writer of one run log; use it in a ``with`` block.

    Messages are written in chunks of `CHUNK_BYTES`, or at `flush`. Only the owner may read the
    file, because it shows where the robot was. Mode "w" replaces an existing file, "x" refuses to.

    Raises:
        OutputError: the file cannot be written. All methods raise it.
    """

    def __init__(self, path: Path, mode: Literal["w", "x"] = "w") -> None:
        from mcap.writer import Writer  # noqa: PLC0415 - 3 MB, which a reader does not need

        self._path, self._floors = path, ONE_MAP
        self._channels: dict[str, int] = {}
        with self._named():
            self._file = open(path, f"{mode}b", opener=_private)  # noqa: SIM115 - no opener
            self._writer = Writer(self._file, chunk_size=CHUNK_BYTES)
            self._writer.start(profile=PROFILE, library="clustermcl")

    def __enter__(self) -> "RunLog":
        return self

    def __exit__(self, *_how: object) -> None:
        self.close()

    def on_map(self, grid_map: GridMap, at_ns: int, max_cells: int = MAX_MAP_CELLS) -> None:
        """Write the map of the following steps, downsampled if it has more than `max_cells`."""
        self._floors = grid_map.floors
        self.write(GRID, foxglove.grid(grid_map, at_ns, max_cells), at_ns)

    def on_scan(self, scan: Scan, at_ns: int) -> None:
        """Write a step's beams and odometry at a time of the recording."""
        stamp_ns = scan.stamp_ns
        link = foxglove.frame_transform(stamp_ns, ODOM, BASE, scan.odom_from_robot)
        self.write(ODOMETRY, link, at_ns)
        self.write(SCAN, foxglove.laser_scan(scan, scan), at_ns)
        for number, beams in enumerate(scan.others, start=1):
            self.write(f"{SCAN}_{number}", foxglove.laser_scan(scan, beams), at_ns)

    def on_belief(self, belief: Belief, at_ns: int) -> None:
        stamp_ns = belief.stamp_ns
        self.write(BELIEF, belief, at_ns)
        belief = self._floors.drawn(belief)
        self.write(PLACES, foxglove.places(belief.hypotheses, stamp_ns), at_ns)
        if (best := belief.best) is not None:
            self.write(POSE, foxglove.posed(best.pose, stamp_ns), at_ns)
            there, odometry = np.array(best.pose), np.array(belief.odom_from_robot)
            odom = pose_tuple(compose(there, inverse(odometry)))
            self.write(ODOMETRY, foxglove.frame_transform(stamp_ns, MAP, ODOM, odom), at_ns)

    def write(self, topic: str, message: object, at_ns: int, *, packed: bool = False) -> None:
        """Append a message as JSON, or as MessagePack; all messages of a topic have one type."""
        codec = msgspec.msgpack if packed else msgspec.json
        at_ns, data = max(at_ns, 0), codec.encode(message)
        with self._named():
            if topic not in self._channels:
                name = SCHEMAS.get(topic.partition("_")[0], f"clustermcl{topic.replace('/', '.')}")
                form = ("", b"") if packed else ("jsonschema", _JSON_SCHEMA)
                schema = self._writer.register_schema(name, *form)
                encoding = "msgpack" if packed else "json"
                self._channels[topic] = self._writer.register_channel(topic, encoding, schema)
            self._writer.add_message(self._channels[topic], at_ns, data, at_ns)

    def flush(self) -> None:
        """Write the current chunk, so that its messages survive a kill of this process."""
        with self._named():
            self._writer.flush()  # type: ignore[no-untyped-call] # the library's

    @property
    def size(self) -> int:
        """Size of the file [bytes], without messages that are not written yet."""
        return self._file.tell()

    @property
    def is_removed(self) -> bool:
        return os.fstat(self._file.fileno()).st_nlink == 0

    def close(self) -> None:
        with self._named(), self._file:
            self._writer.finish()  # type: ignore[no-untyped-call] # the library's

    def abandon(self) -> None:
        """Close a file after a failed write, without its index."""
        with suppress(OSError):
            self._file.close()

    @contextmanager
    def _named(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise OutputError(self._path, error) from error


def _private(path: str, flags: int) -> int:
    return os.open(path, flags, 0o600)


class LogMessage(NamedTuple):
    """A message of a run log, still encoded."""

    topic: str
    at_ns: int
    data: bytes


T = TypeVar("T")


class RunLogReader:
    """Reader of one run log.

    Attributes:
        cut: why reading ended early, known once all messages are read; empty: the file is whole.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.cut = path, ""

    def messages(self) -> Iterator[LogMessage]:
        """Yield all messages in the order in which they were written, up to the first damaged byte.

        Raises:
            RecordingError: the file is not a run log, or cannot be opened.
        """
        channels: dict[int, str] = {}
        try:
            with self.path.open("rb") as file:
                if not _MAGIC.startswith(file.read(len(_MAGIC))):
                    raise RecordingError(self.path, "is not an MCAP file")
                file.seek(0)
                records = mcap_records(file)
                if not _is_ours(next(records)):
                    raise RecordingError(self.path, "was not written by clustermcl")
                for record in records:
                    match record:
                        case Channel():
                            channels[record.id] = record.topic
                        case Message():
                            topic = channels[record.channel_id]
                            if len(record.data) > MAX_MESSAGE_BYTES and topic != GRID:
                                raise ValueError(f"a message of {topic} is too long")
                            yield LogMessage(topic, record.log_time, record.data)
        except RecordingError:
            raise
        except OSError as error:
            raise RecordingError(self.path, os_problem(error)) from error
        except Exception as broken:  # noqa: BLE001 - damaged bytes raise whatever they hit
            self.cut = str(broken) or type(broken).__name__


def is_run_log(path: Path) -> bool:
    """Return whether a file, or any MCAP file of a folder, is a run log."""
    for file in log_files(path):
        # Damaged bytes raise whatever they hit, as in `RunLogReader.messages`.
        with suppress(Exception), file.open("rb") as opened:
            if _is_ours(next(mcap_records(opened))):
                return True
    return False


def log_files(path: Path) -> list[Path]:
    """Return the file, or the MCAP files of a folder sorted by name; only regular files."""
    files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    return [file for file in files if file.is_file()]


def _is_ours(record: object) -> bool:
    return isinstance(record, Header) and record.profile == PROFILE


def decoded(message: LogMessage, kind: type[T], path: Path) -> T:
    """Decode a JSON message; a `RecordingError` says why it is not of this type."""
    try:
        content = conversion.decoded(message.data, kind, msgspec.json)
        problem = problem_of(content)
    except (ValueError, RecursionError) as error:  # of msgspec, or of invalid strings
        problem = str(error)
    if problem:
        raise RecordingError(path, f"{message.topic}: {problem}")
    return content


def playback(path: Path) -> tuple[list[Entry], list[SkippedLine]]:
    """Return the scans and odometry of a run as entries, and the damaged ends of its files.

    Raises:
        RecordingError: a file is not a run log, a message is malformed, or the run is too long.
    """
    entries, skipped, left = list[Entry](), list[SkippedLine](), MAX_PLAYBACK_BYTES
    for file in log_files(path):
        log, number = RunLogReader(file), 0
        most = most_unpacked(file.stat().st_size, _FREE_PLAYBACK_BYTES)
        for number, message in enumerate(log.messages(), start=1):
            if message.topic.startswith((SCAN, ODOMETRY)):
                left, most = left - len(message.data), most - len(message.data)
                if min(left, most) < 0:
                    raise RecordingError(file, "its scans and odometry are too long unpacked")
            if message.topic.startswith(SCAN):
                entries.append(Entry(number, _laser_reading(message, file)))
            elif message.topic == ODOMETRY:
                link = decoded(message, foxglove.LinkFields, file)
                if link.child_frame_id == BASE:
                    entries.append(odometry_entry(number, link.stamp_ns, link.parent_from_child))
        if log.cut:
            skipped.append(SkippedLine(number + 1, f"from here on cut off or damaged: {log.cut}"))
    return entries, skipped


def _laser_reading(message: LogMessage, path: Path) -> LaserReading:
    scan = decoded(message, foxglove.LaserFields, path)
    return LaserReading(
        sender=SENDER,
        stamp_ns=scan.stamp_ns,
        odom_from_robot=scan.odom_from_robot,
        laser=message.topic.removeprefix("/"),
        **msgspec.structs.asdict(scan.beams()),
    )


def last_map(path: Path) -> GridMap:
    """Return the newest map of a run.

    Raises:
        RecordingError: the run has no map, or the map is malformed.
    """
    for file in reversed(log_files(path)):
        grids = deque((one for one in RunLogReader(file).messages() if one.topic == GRID), maxlen=1)
        if grids:
            return map_in(grids[0], file)
    raise RecordingError(path, "no map in it; name one by --map")


def map_in(message: LogMessage, path: Path) -> GridMap:
    """Decode a message with a map; a `RecordingError` says why it is malformed."""
    try:
        return decoded(message, foxglove.MapFields, path).grid_map()
    except ValueError as error:
        raise RecordingError(path, f"{message.topic}: {error}") from None
