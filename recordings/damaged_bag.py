"""Bags that were cut off, by a full disk, a flat battery or a broken copy, made readable again.

`rosbags` wants the index that a recorder writes last. What stands before the cut is written into a
new bag; of a chunk that the cut went through, too, as far as it can be unpacked. Needs ``ros2``.
"""

import io
import shutil
import sqlite3
import struct
import zlib
from collections.abc import Iterable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, BinaryIO

from recordings.bag_chunks import MOST_FILE_BYTES, unpacked

_ROS1_START = b"#ROSBAG V2.0\n"
_ROS1_MESSAGE, _ROS1_CHUNK, _ROS1_CONNECTION = 2, 5, 7

_MCAP_MAGIC = b"\x89MCAP0\r\n"
_MCAP_SCHEMA, _MCAP_CHANNEL, _MCAP_MESSAGE = 3, 4, 5
_MCAP_FOOTER, _MCAP_CHUNK, _MCAP_DATA_END = 2, 6, 15
_MCAP_HEAD = struct.Struct("<BQ")  # kind, length

_MOST_BYTES = 2**30
"""No record has more; a length that says so is damaged, and would be allocated."""

_SQL_TABLES = ("schema", "topics", "message_definitions", "messages")


def mend(damaged: Path, mended: Path) -> None:
    """Write what a damaged bag file still holds into a new one of the same kind.

    Args:
        damaged: a file whose suffix tells its kind: ``.bag``, ``.mcap`` or ``.db3``.
        mended: does not exist.

    Raises:
        Exception: of many kinds: nothing can be read.
    """
    match damaged.suffix:
        case ".bag":
            _mend_ros1(damaged, mended)
        case ".mcap":
            _mend_mcap(damaged, mended)
        case _:
            _mend_sqlite(damaged, mended)


# --- ROS 1 --------------------------------------------------------------------------------------


def _mend_ros1(damaged: Path, mended: Path) -> None:
    from rosbags.rosbag1 import Writer  # noqa: PLC0415 - an extra
    from rosbags.typesys.msg import normalize_msgtype  # noqa: PLC0415 - see above

    connections: dict[bytes, Any] = {}
    with damaged.open("rb") as source, Writer(mended) as writer:
        if source.read(len(_ROS1_START)) != _ROS1_START:
            raise ValueError("its first line is not that of a bag")
        for head, data in _bounded(_ros1_messages(source)):
            number = head[b"conn"]
            if head[b"op"][0] == _ROS1_CONNECTION and number not in connections:
                names = _ros1_fields(data)
                connections[number] = writer.add_connection(
                    head[b"topic"].decode(),
                    normalize_msgtype(names[b"type"].decode()),
                    msgdef=names[b"message_definition"].decode(),
                    md5sum=names[b"md5sum"].decode(),
                    callerid=number.hex(),  # tells connections of one topic apart
                )
            elif head[b"op"][0] == _ROS1_MESSAGE:
                seconds, nanoseconds = struct.unpack("<II", head[b"time"])
                writer.write(connections[number], seconds * 1_000_000_000 + nanoseconds, data)


def _ros1_messages(source: BinaryIO) -> Iterator[tuple[dict[bytes, bytes], bytes]]:
    """Connections and messages of all chunks, to the cut."""
    for head, data, whole in _ros1_records(source):
        if head[b"op"][0] == _ROS1_CHUNK:
            content = unpacked(head[b"compression"].decode(), data)
            inner = (
                (head, data) for head, data, whole in _ros1_records(io.BytesIO(content)) if whole
            )
            yield from inner
        elif whole and head[b"op"][0] in (_ROS1_MESSAGE, _ROS1_CONNECTION):
            yield head, data


def _ros1_records(source: BinaryIO) -> Iterator[tuple[dict[bytes, bytes], bytes, bool]]:
    """Fields and data of each record, and whether the data are whole."""
    while len(size := source.read(4)) == 4:
        head_bytes = int.from_bytes(size, "little")
        head = source.read(min(head_bytes, _MOST_BYTES))
        data_size = source.read(4)
        if len(head) < head_bytes or len(data_size) < 4:
            return
        data_bytes = int.from_bytes(data_size, "little")
        data = source.read(min(data_bytes, _MOST_BYTES))
        yield _ros1_fields(head), data, len(data) == data_bytes


def _ros1_fields(head: bytes) -> dict[bytes, bytes]:
    fields: dict[bytes, bytes] = {}
    at = 0
    while at < len(head):
        end = at + 4 + int.from_bytes(head[at : at + 4], "little")
        name, _, value = head[at + 4 : end].partition(b"=")
        fields[name] = value
        at = end
    return fields


# --- MCAP ---------------------------------------------------------------------------------------


def _mend_mcap(damaged: Path, mended: Path) -> None:
    """Write it with an index: without one, messages must be in the order of their times."""
    from mcap.writer import CompressionType, Writer  # noqa: PLC0415 - an extra

    with damaged.open("rb") as source, mended.open("wb") as target:
        if source.read(len(_MCAP_MAGIC)) != _MCAP_MAGIC:
            raise ValueError("its first bytes are not those of MCAP")
        writer = Writer(target, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        with suppress(Exception):  # of many kinds: from here on it is damaged
            _copy_mcap(source, writer)
        writer.finish()  # type: ignore[no-untyped-call] # the library's


def _copy_mcap(source: BinaryIO, writer: Any) -> None:
    """Copy the messages, to the cut."""
    from mcap.data_stream import ReadDataStream  # noqa: PLC0415 - an extra
    from mcap.records import Channel, Message, Schema  # noqa: PLC0415 - see above

    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    for kind, data in _bounded(_mcap_contents(source)):
        stream = ReadDataStream(io.BytesIO(data))
        if kind == _MCAP_SCHEMA:
            schema = Schema.read(stream)
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
        elif kind == _MCAP_CHANNEL:
            channel = Channel.read(stream)
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic,
                    channel.message_encoding,
                    schemas[channel.schema_id],
                    channel.metadata,
                )
        elif kind == _MCAP_MESSAGE:
            message = Message.read(stream, len(data))
            writer.add_message(
                channels[message.channel_id],
                message.log_time,
                message.data,
                message.publish_time,
                message.sequence,
            )


def _mcap_contents(source: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Records that are whole, also those in chunks, to the cut or the end of the data."""
    for kind, data, whole in _mcap_records(source):
        if kind in (_MCAP_DATA_END, _MCAP_FOOTER):
            return
        if kind == _MCAP_CHUNK:
            unpacked = _mcap_unpacked(data)
            checksum = int.from_bytes(data[24:28], "little")
            if whole and checksum not in (0, zlib.crc32(unpacked)):
                return
            inner = _mcap_records(io.BytesIO(unpacked))
            yield from ((one, content) for one, content, is_whole in inner if is_whole)
        elif whole:
            yield kind, data


def _mcap_records(source: BinaryIO) -> Iterator[tuple[int, bytes, bool]]:
    """Kind and content of each record, and whether it is whole."""
    while len(head := source.read(_MCAP_HEAD.size)) == _MCAP_HEAD.size:
        kind, size = _MCAP_HEAD.unpack(head)
        data = source.read(min(size, _MOST_BYTES))
        yield kind, data, len(data) == size


def _mcap_unpacked(chunk: bytes) -> bytes:
    """What can be unpacked of a chunk that is cut off."""
    # start time, end time, size, checksum, name of the compression, compressed size, records
    name_size = int.from_bytes(chunk[28:32], "little")
    name, records_at = chunk[32 : 32 + name_size].decode(), 32 + name_size + 8
    return unpacked(name, chunk[records_at:])


# --- sqlite -------------------------------------------------------------------------------------


def _mend_sqlite(damaged: Path, mended: Path) -> None:
    padded = mended.with_name("padded.db3")
    shutil.copyfile(damaged, padded)
    with padded.open("r+b") as file:
        head = file.read(32)
        # sqlite opens no file that is shorter than its first page says; pages of zeros it refuses
        # only when it comes to them. A page size of 1 stands for 65,536.
        page_bytes, pages = int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
        file.truncate(pages * (page_bytes if page_bytes > 1 else 65_536))
    address = f"{padded.resolve().as_uri()}?immutable=1"
    with (
        closing(sqlite3.connect(address, uri=True)) as source,
        closing(sqlite3.connect(mended)) as target,
    ):
        made = dict(source.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'"))
        for table in _SQL_TABLES:
            if table in made:
                target.execute(made[table])
                _copy_rows(source, target, table)
        target.commit()


def _copy_rows(source: sqlite3.Connection, target: sqlite3.Connection, table: str) -> None:
    """Copy the rows in their order until one cannot be read."""
    with suppress(sqlite3.DatabaseError):
        for row in source.execute(f"SELECT * FROM {table} ORDER BY rowid"):
            places = ", ".join("?" * len(row))
            target.execute(f"INSERT INTO {table} VALUES ({places})", row)


# --- both


def _bounded(contents: Iterable[tuple[Any, bytes]]) -> Iterator[tuple[Any, bytes]]:
    """As many as may be written: what a file stands for may be more than any disk holds."""
    left = MOST_FILE_BYTES
    for head, data in contents:
        left -= len(data)
        if left < 0:
            return
        yield head, data
