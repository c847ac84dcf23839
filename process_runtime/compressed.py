"""Input files that may be compressed: gzip and xz are recognised by their first bytes."""

import gzip
import lzma
import zlib
from pathlib import Path
from typing import BinaryIO, cast

from protocol.errors import InputFileError

MAX_FILE_BYTES = 2**29
"""A longer file, once decompressed, is refused: it is a mistake or an attack, not an input.

The largest public recordings have a fifth of it; a kilobyte of gzip can announce a terabyte.
"""

BROKEN_STREAM_ERRORS = (EOFError, zlib.error, lzma.LZMAError, gzip.BadGzipFile)
"""What reading a cut or damaged compressed file raises."""

_GZIP_MAGIC, _XZ_MAGIC = b"\x1f\x8b", b"\xfd7zXZ\x00"


def open_decompressed(path: Path) -> BinaryIO:
    """Open a file that may be compressed; what is read from it is not.

    Raises:
        OSError: the file cannot be opened. A broken stream shows only while reading, as one of
            `BROKEN_STREAM_ERRORS`.
    """
    with path.open("rb") as plain:
        start = plain.read(len(_XZ_MAGIC))
    if start.startswith(_GZIP_MAGIC):
        return cast(BinaryIO, gzip.open(path, "rb"))
    if start.startswith(_XZ_MAGIC):
        return cast(BinaryIO, lzma.open(path, "rb"))
    return path.open("rb")


def read_decompressed(path: Path, error: type[InputFileError]) -> bytes:
    """All bytes of a file, decompressed.

    Args:
        path: the file.
        error: what to raise, so that a map is reported as a map and a recording as one.

    Raises:
        InputFileError: as `error`: the file is missing, unreadable, cut, damaged or too long.
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
    """A sentence for a file with more than `MAX_FILE_BYTES`."""
    return f"longer than {MAX_FILE_BYTES // 2**20} MiB unpacked, more than any input here"


def broken_stream_problem(broken: BaseException) -> str:
    """A sentence for one of `BROKEN_STREAM_ERRORS`."""
    if isinstance(broken, EOFError):
        return "the compressed file is cut off; copy or download it again"
    return f"the compressed file is damaged ({broken}); copy or download it again"


def os_problem(failed: OSError) -> str:
    """A sentence for a file that cannot be read."""
    if isinstance(failed, FileNotFoundError):
        return "no such file; check the path"
    if isinstance(failed, IsADirectoryError):
        return "is a folder, not a file; name a file in it"
    return f"cannot be read: {failed.strerror or failed}"
