"""The folder of a recording: files of bounded size, of which the oldest are removed.

A file's name is that of its series, which is when its coordinator began [us], and its number in
it: sorted by name, files are sorted by time. A file is only ever appended to, so the folder may be
copied at any moment.
"""

import os
import re
from collections.abc import Sequence
from io import FileIO
from pathlib import Path

from coordinator.recorder.blocks import BlockWriter
from coordinator.recorder.records import Head, Record

FILES = 10
"""So many of them make a full ring."""
MAX_FILE_BYTES = 8_000_000
"""A file is read as a whole."""
_NAME = re.compile(r"(\d{17,20})-(\d{6})\.flight")


class Ring:
    """Writes the files of one series, and keeps the folder within its bound.

    Args:
        folder: of one robot.
        series: tells this coordinator from others, and rises from one to the next.
        max_bytes: of all files together; the newest may pass it by what is written at a time.
    """

    def __init__(self, folder: Path, series: int, max_bytes: int) -> None:
        self._folder, self._series, self._max_bytes = folder, series, max_bytes
        self._file_bytes = min(max_bytes // FILES, MAX_FILE_BYTES)
        self._number = 0
        self._file: FileIO | None = None
        self._blocks = BlockWriter()
        self._written_bytes = 0

    @property
    def is_open(self) -> bool:
        """Whether there is a file to write to."""
        return self._file is not None

    @property
    def is_full(self) -> bool:
        """Whether it is time for the next file."""
        return self._written_bytes >= self._file_bytes

    def begin(self, head: Head) -> None:
        """Begin the next file; the oldest ones give way.

        Raises:
            OSError: it cannot be written; so for `write`. No file is open then.
        """
        self.close()
        self._folder.mkdir(parents=True, exist_ok=True)
        self._make_room()
        path = self._folder / f"{self._series:017d}-{self._number:06d}.flight"
        self._number += 1
        self._file = FileIO(path, "x", opener=_private)
        self._blocks, self._written_bytes = BlockWriter(), 0
        try:
            self._append(self._blocks.first(head))
        except OSError:  # on a full disk there would soon be thousands of empty ones
            path.unlink(missing_ok=True)
            raise

    def write(self, records: Sequence[Record]) -> None:
        """Append records; a file that was removed meanwhile is closed.

        Raises:
            OSError: see `begin`.
        """
        if self._file is not None and os.fstat(self._file.fileno()).st_nlink == 0:
            self.close()
            raise FileNotFoundError(f"its file was removed from {self._folder}")
        self._append(self._blocks.next(records))

    def close(self) -> None:
        """Close the file, if there is one."""
        if self._file is not None:
            file, self._file = self._file, None
            file.close()

    def _append(self, block: bytes) -> None:
        if self._file is None:
            raise ValueError("no file has begun")
        left = memoryview(block)
        try:
            while left:  # a disk that is nearly full takes a part
                left = left[self._file.write(left) :]
        except OSError:
            self.close()
            raise
        self._written_bytes += len(block)

    def _make_room(self) -> None:
        sizes = {path: path.stat().st_size for path in files_in(self._folder)}
        for path in sorted(sizes):
            if sum(sizes.values()) + self._file_bytes <= self._max_bytes:
                break
            path.unlink(missing_ok=True)
            del sizes[path]


def _private(path: str, flags: int) -> int:
    """A recording tells where the robot was: nobody but its owner may read it."""
    return os.open(path, flags, 0o600)


def files_in(folder: Path) -> list[Path]:
    """The files of a recording, oldest first; a pipe would never end."""
    found = (path for path in folder.glob("*.flight") if _NAME.fullmatch(path.name))
    return sorted(path for path in found if path.is_file())


def series_of(path: Path) -> tuple[int, int]:
    """The series of a file, and its number in it."""
    match = _NAME.fullmatch(path.name)
    if match is None:
        raise ValueError(f"{path.name} is no name of a recording's file")
    return int(match[1]), int(match[2])
