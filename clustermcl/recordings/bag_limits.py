"""Limits for what the library `rosbags` reads: kilobytes may stand for gigabytes, or for no end."""

import sqlite3
from bz2 import BZ2Decompressor
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial, partialmethod
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO

import zstandard
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from rosbags.rosbag1 import reader as ros1
from rosbags.rosbag2 import metadata, reader, storage_mcap
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from clustermcl.protocol.errors import InputFileError
from clustermcl.recordings.bag_chunks import unpacked
from clustermcl.runtime.compressed import most_unpacked
from clustermcl.runtime.yaml_text import yaml_of

_FREE_CHUNK_BYTES = 2**28
"""All that is unpacked may have these bytes whatever its ratio: one `OccupancyGrid`."""
_MOST_YAML_BYTES = 2**19
_COMPUTED = """SELECT 1 FROM sqlite_master AS each, pragma_table_xinfo(each.name) AS held
    WHERE each.type = 'view' OR held.hidden OR length(held.dflt_value) > 99"""
_open_database, _read_index = Sqlite3Reader.open, ros1.Reader.read_index_data


@contextmanager
def limited(path: Path, error: type[InputFileError], packed_bytes: int) -> Iterator[None]:
    """Have the library read one bag within limits; afterwards it reads as before."""
    parts = _Limits(path, error, packed_bytes).parts()
    library_s = [(owner, name, vars(owner)[name]) for owner, name, _ in parts]
    try:
        for owner, name, part in parts:
            setattr(owner, name, part)
        yield
    finally:
        for owner, name, part in library_s:
            setattr(owner, name, part)


class _Limits:
    def __init__(self, path: Path, error: type[InputFileError], packed_bytes: int) -> None:
        self._path, self._error = path, error
        self._left_to_read = 4 * packed_bytes  # each part to find the messages, and for them
        self._left = most_unpacked(packed_bytes, _FREE_CHUNK_BYTES)

    def parts(self) -> Sequence[tuple[Any, str, Any]]:
        """Return owner, name and replacement of what the library reads without limits."""
        bz2, lz4 = (
            partial(self._by_object, kind) for kind in (BZ2Decompressor, LZ4FrameDecompressor)
        )
        of_mcap = {"": self._as_it_is, "lz4": lz4, "zstd": self._by_zstd}
        yaml = SimpleNamespace(load=self._yaml)
        return (
            (ros1, "decompressors", ros1.decompressors | {"bz2": bz2, "lz4": lz4}),
            (ros1.Reader, "read_index_data", partialmethod(_index, self._count_read)),
            (storage_mcap, "DECOMPRESSORS", of_mcap),
            (reader, "zstd", SimpleNamespace(decompress=self._by_zstd, open=self._opened)),
            *((module, "YAML", lambda **_: yaml) for module in (reader, metadata)),
            (Sqlite3Reader, "open", _open_checked),
        )

    def _as_it_is(self, content: bytes, _size: int) -> bytes:
        self._count_read(len(content))
        return content

    def _by_zstd(self, packed: bytes, _size: int = 0) -> bytes:
        return self._counted(unpacked("zstd", packed, self._most))

    def _by_object(self, kind: Any, packed: bytes, _size: int = 0) -> bytes:
        unpacker = kind()
        content: bytes = unpacker.decompress(packed, self._most + 1)
        if not unpacker.eof and len(content) <= self._most:
            raise EOFError("a chunk is cut off")
        return self._counted(content)

    @contextmanager
    def _opened(self, file: BinaryIO, _mode: str) -> "Iterator[SimpleNamespace]":
        with zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True) as stream:
            yield SimpleNamespace(read=lambda count: self._counted(stream.read(count)))

    def _yaml(self, text: str) -> Any:
        if len(text) > _MOST_YAML_BYTES:
            raise ValueError(f"more than {_MOST_YAML_BYTES} bytes of YAML")
        return yaml_of(text.encode(), self._path, self._error)[0]

    def _count_read(self, count: int) -> None:
        self._left_to_read -= count
        if self._left_to_read < 0:
            raise ValueError("parts of it lie one over the other")

    @property
    def _most(self) -> int:
        return min(self._left, _FREE_CHUNK_BYTES)

    def _counted(self, content: bytes) -> bytes:
        if len(content) > self._most:
            raise ValueError("it unpacks to far more than its size")
        self._left -= len(content)
        return content


def _index(bag: Any, count: Callable[[int], None], *chunk: Any) -> None:
    start = bag.bio.tell()
    _read_index(bag, *chunk)
    count(bag.bio.tell() - start)


def _open_checked(database: Sqlite3Reader) -> None:
    """Refuse what the library would miss, and what SQLite computes: maybe gigabytes, or no end."""
    path = Path(str(database.path)).absolute()
    if (log := path.with_name(f"{path.name}-wal")).exists() and log.stat().st_size:
        raise ValueError(f"its end is in {log.name}; 'PRAGMA journal_mode=DELETE' would merge it")
    address = f"{path.as_uri()}?immutable=1"
    with closing(sqlite3.connect(address, uri=True)) as connection:
        if connection.execute(_COMPUTED).fetchone():
            raise ValueError("it has views, or columns that are computed")
    _open_database(database)
