"""Input files that may be compressed: gzip, xz and zstd are recognised by their first bytes."""

import gzip
import lzma
import zlib
from pathlib import Path
from typing import BinaryIO, cast

import zstandard

from protocol.errors import InputFileError

MAX_FILE_BYTES = 2**29
"""Longest input after decompression, five times the largest public recording: a few kilobytes of
gzip can expand to terabytes."""

BROKEN_STREAM_ERRORS = (
    EOFError,
    zlib.error,
    lzma.LZMAError,
    gzip.BadGzipFile,
    zstandard.ZstdError,
)
"""Exceptions from reading a truncated or damaged compressed file."""

_GZIP_MAGIC, _XZ_MAGIC, _ZSTD_MAGIC = b"\x1f\x8b", b"\xfd7zXZ\x00", b"\x28\xb5\x2f\xfd"


def open_decompressed(path: Path) -> BinaryIO:
    """Open a file that may be compressed, for reading its decompressed bytes.

    Raises:
        OSError: the file cannot be opened. A damaged stream raises one of
            `BROKEN_STREAM_ERRORS` while it is read.
    """
    with path.open("rb") as plain:
        start = plain.read(len(_XZ_MAGIC))
    if start.startswith(_GZIP_MAGIC):
        return cast(BinaryIO, gzip.open(path, "rb"))
    if start.startswith(_XZ_MAGIC):
        return cast(BinaryIO, lzma.open(path, "rb"))
    if start.startswith(_ZSTD_MAGIC):
        return cast(BinaryIO, zstandard.open(path, "rb"))
    return path.open("rb")


def read_decompressed(path: Path, error: type[InputFileError]) -> bytes:
    """Read a whole file, decompressed.

    Raises:
        InputFileError: of the type `error`: the file is missing, unreadable, truncated, damaged or
            too long.
    """
    try:
        with open_decompressed(path) as stream:
            content = stream.read(MAX_FILE_BYTES + 1)
    except BROKEN_STREAM_ERRORS as broken:
        raise error(path, broken_stream_problem(broken)) from broken
    except OSError as failed:
        raise error(path, os_problem(failed)) from failed
    if len(content) > MAX_FILE_BYTES:
        raise error(path, too_long_problem())
    return content


def too_long_problem() -> str:
    return f"longer than {MAX_FILE_BYTES // 2**20} MiB unpacked, more than any input here"


def broken_stream_problem(broken: BaseException) -> str:
    """Return the message for one of `BROKEN_STREAM_ERRORS`."""
    if isinstance(broken, EOFError):
        return "the compressed file is cut off; copy or download it again"
    return f"the compressed file is damaged ({broken}); copy or download it again"


def os_problem(failed: OSError) -> str:
    """Return the message for a file that cannot be read."""
    if isinstance(failed, FileNotFoundError):
        return "no such file; check the path"
    if isinstance(failed, IsADirectoryError):
        return "is a folder, not a file; name a file in it"
    return f"cannot be read: {failed.strerror or failed}"
