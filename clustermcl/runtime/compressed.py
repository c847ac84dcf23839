"""Input files that may be compressed: gzip, xz and zstd are recognised by their first bytes."""

import gzip
import lzma
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, Literal, cast

import zstandard

from clustermcl.protocol.errors import InputFileError

MAX_FILE_BYTES = 2**29
"""Longest input after decompression, five times the largest public recording: a few kilobytes of
gzip can expand to terabytes."""
MAX_RATIO = 80
"""Decompressed bytes per byte of a recording: those of robots have up to 10, of one that stands
still up to 30."""
MAX_TEXT_BYTES = 2**24
"""A text may have these bytes whatever its ratio."""

BROKEN_STREAM_ERRORS = (EOFError, zlib.error, lzma.LZMAError, gzip.BadGzipFile, zstandard.ZstdError)

_LFS_POINTER = b"version https://git-lfs.github.com/spec/"
_OPENERS: dict[bytes, Callable[[Path, Literal["rb"]], object]] = {
    b"\x1f\x8b": gzip.open,
    b"\xfd7zXZ\x00": lzma.open,
    b"\x28\xb5\x2f\xfd": zstandard.open,
}


def open_decompressed(path: Path) -> BinaryIO:
    """Open a file that may be compressed, for reading its decompressed bytes.

    Raises:
        OSError: the file cannot be opened. A damaged stream raises one of
            `BROKEN_STREAM_ERRORS` while it is read.
    """
    with path.open("rb") as plain:
        start = plain.read(len(_LFS_POINTER))
    if start == _LFS_POINTER:
        raise OSError("is a pointer of Git LFS, not the file itself: run 'git lfs pull'")
    for magic, opener in _OPENERS.items():
        if start.startswith(magic):
            return cast(BinaryIO, opener(path, "rb"))
    return path.open("rb")


def most_unpacked(packed_bytes: int, free_bytes: int) -> int:
    """Return the limit for the content of a file [bytes], by its size."""
    return free_bytes + MAX_RATIO * packed_bytes


def first_bytes(path: Path, count: int, error: type[InputFileError]) -> bytes:
    """Read up to `count` bytes of a file, decompressed.

    Raises:
        InputFileError: of the type `error`: the file is missing, unreadable, truncated or damaged.
    """
    try:
        with open_decompressed(path) as stream:
            return stream.read(count)
    except BROKEN_STREAM_ERRORS as broken:
        raise error(path, broken_stream_problem(broken)) from broken
    except OSError as failed:
        raise error(path, os_problem(failed)) from failed


def read_decompressed(path: Path, error: type[InputFileError], most: int | None = None) -> bytes:
    """Read a whole file, decompressed; errors as of `first_bytes`, also if it is too long."""
    most = most or MAX_FILE_BYTES
    content = first_bytes(path, most + 1, error)
    if len(content) > most:
        raise error(path, too_long_problem(most))
    return content


def too_long_problem(most: int) -> str:
    return f"longer than {most / 2**20:.3g} MiB unpacked, more than any such input"


def broken_stream_problem(broken: BaseException) -> str:
    if isinstance(broken, EOFError):
        return "the compressed file is cut off; copy or download it again"
    return f"the compressed file is damaged ({broken}); copy or download it again"


def os_problem(failed: OSError) -> str:
    if isinstance(failed, FileNotFoundError):
        return "no such file; check the path"
    if isinstance(failed, IsADirectoryError):
        return "is a folder, not a file; name a file in it"
    return f"cannot be read: {failed.strerror}" if failed.strerror else str(failed)
