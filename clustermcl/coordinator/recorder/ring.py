"""The folder of a recording: files of bounded size, of which the oldest are removed.

A file name consists of the series, the start time of its coordinator [us] but above all in the
folder, and the file's number in it. So files sorted by name are in the order of writing, even after
the clock was set back. Files only grow, so the folder can be copied at any time.
"""

import re
from contextlib import suppress
from pathlib import Path

from clustermcl.coordinator.recorder.records import Head
from clustermcl.recordings.run_log import RunLog
from clustermcl.runtime.output_files import OutputError

FILES = 10
"""Number of files in a full ring."""
MAX_FILE_BYTES = 8_000_000
HEAD, EVENTS = "/coordinator/head", "/coordinator/events"
"""Topics next to those of `clustermcl.recordings.run_log`."""
_NAME = re.compile(r"(\d{17,20})-\d{6}\.mcap")


class Ring:
    """Writes the files of one series, and removes old files of the folder of one robot.

    All files together have `max_bytes`; the newest may exceed it by one chunk and its index.
    """

    def __init__(self, folder: Path, series: int, max_bytes: int) -> None:
        newest = max((int(series_of(file)) for file in files_in(folder)), default=0)
        self._folder, self._series, self._max_bytes = folder, max(series, newest + 1), max_bytes
        self._file_bytes = min(max_bytes // FILES, MAX_FILE_BYTES)
        self._number = 0
        self.log: RunLog | None = None

    @property
    def is_full(self) -> bool:
        return self.log is not None and self.log.size >= self._file_bytes

    def begin(self, head: Head) -> RunLog:
        """Remove the oldest files if needed, and begin the next file.

        Raises:
            OSError, OutputError: the folder or the file cannot be written.
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
        except OutputError:  # a full disk would soon contain thousands of empty files
            log.abandon()
            path.unlink(missing_ok=True)
            raise
        self.log = log
        return log

    def flush(self) -> None:
        """Write all messages to the disk.

        Raises:
            OSError, OutputError: the file was removed, or cannot be written.
        """
        if self.log is not None:
            self.log.flush()
            if self.log.is_removed:
                raise FileNotFoundError(f"its file was removed from {self._folder}")

    def close(self, *, broken: bool = False) -> None:
        """Close the file, at once if it is `broken`: it cannot be written."""
        log, self.log = self.log, None
        with suppress(OutputError):  # a file without an index is readable to its last chunk
            if log is not None and broken:
                log.abandon()
            elif log is not None:
                log.close()

    def _make_room(self) -> None:
        sizes = {path: path.stat().st_size for path in files_in(self._folder)}
        for path in sorted(sizes):
            if sum(sizes.values()) + self._file_bytes <= self._max_bytes:
                break
            path.unlink(missing_ok=True)
            del sizes[path]


def files_in(folder: Path) -> list[Path]:
    """Return the files of a folder's recordings, oldest first."""
    found = (path for path in folder.glob("*") if _NAME.fullmatch(path.name))
    return sorted(path for path in found if path.is_file())


def series_of(path: Path) -> str:
    return path.name.partition("-")[0]
