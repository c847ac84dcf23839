"""The folder of a recording: files of bounded size, of which the oldest are removed.

A file name consists of the start time of its coordinator [us], which identifies the series, and
the file's number in the series. So files sorted by name are sorted by time. Files are only appended
to, so the folder can be copied at any moment.
"""

import re
from contextlib import suppress
from pathlib import Path

from coordinator.recorder.records import Head
from process_runtime.output_files import OutputError
from recordings.run_log import RunLog

FILES = 10
"""A full ring has this number of files."""
MAX_FILE_BYTES = 8_000_000
HEAD, EVENTS = "/coordinator/head", "/coordinator/events"
"""Topics next to those of `recordings.run_log`."""
_NAME = re.compile(r"(\d{17,20})-(\d{6})\.(?:mcap|flight)")
"""Files of the second kind are of older versions: they are not read, and make room."""


class Ring:
    """Writes the files of one series, and keeps the folder within its bound.

    Args:
        folder: of one robot.
        series: distinguishes this coordinator from others, and increases from one to the next.
        max_bytes: of all files together; the newest may exceed it by one chunk and its index.

    Attributes:
        log: the file that is written; None: none is open.
    """

    def __init__(self, folder: Path, series: int, max_bytes: int) -> None:
        self._folder, self._series, self._max_bytes = folder, series, max_bytes
        self._file_bytes = min(max_bytes // FILES, MAX_FILE_BYTES)
        self._number = 0
        self.log: RunLog | None = None

    @property
    def is_full(self) -> bool:
        """Whether it is time for the next file."""
        return self.log is not None and self.log.size >= self._file_bytes

    def begin(self, head: Head) -> RunLog:
        """Begin the next file, after the oldest ones were removed.

        Raises:
            OSError: the folder cannot be written; so for `flush`.
            OutputError: the file cannot be written; so for `flush`.
        """
        self.close()
        self._folder.mkdir(parents=True, exist_ok=True)
        self._make_room()
        path = self._folder / f"{self._series:017d}-{self._number:06d}.mcap"
        self._number += 1
        log = RunLog(path, "x")
        try:
            log.write(HEAD, head, head.wall_ns, packed=True)
            log.flush()
        except OutputError:  # on a full disk there would soon be thousands of empty ones
            log.abandon()
            path.unlink(missing_ok=True)
            raise
        self.log = log
        return log

    def flush(self) -> None:
        """Write all messages to the disk; raise `FileNotFoundError` if the file was removed."""
        if self.log is not None:
            self.log.flush()
            if self.log.is_removed:
                raise FileNotFoundError(f"its file was removed from {self._folder}")

    def close(self) -> None:
        """Finish the file, if there is one."""
        log, self.log = self.log, None
        if log is not None:
            with suppress(OutputError):  # without its index it is read up to its last chunk
                log.close()

    def abandon(self) -> None:
        """Close a file that cannot be written."""
        log, self.log = self.log, None
        if log is not None:
            log.abandon()

    def _make_room(self) -> None:
        sizes = {path: path.stat().st_size for path in files_in(self._folder)}
        for path in sorted(sizes):
            if sum(sizes.values()) + self._file_bytes <= self._max_bytes:
                break
            path.unlink(missing_ok=True)
            del sizes[path]


def files_in(folder: Path) -> list[Path]:
    """Return the files of a recording, oldest first; only regular files."""
    found = (path for path in folder.glob("*") if _NAME.fullmatch(path.name))
    return sorted(path for path in found if path.is_file())


def series_of(path: Path) -> tuple[int, int]:
    """Return the series of a file, and the file's number in the series."""
    match = _NAME.fullmatch(path.name)
    if match is None:
        raise ValueError(f"{path.name} is no name of a recording's file")
    return int(match[1]), int(match[2])
