"""The coordinator's state on disk, from which the next process continues.

One file is replaced once a second as a whole, and survives a power cut. Between, states are written
in turn over two others without waiting for the disk: if a process dies while it writes one, the
other is whole. The newest counts. A checksum detects a damaged file, which is logged and not used.
"""

import logging
import threading
import time
from collections import deque
from contextlib import AbstractContextManager, nullcontext
from functools import cache, partial
from pathlib import Path
from urllib.parse import quote

from clustermcl.coordinator.checkpoint import state_in
from clustermcl.protocol.codec import decode, encode, max_bytes
from clustermcl.protocol.conversion import with_checksum, without_checksum
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.work import Checkpoint, check_term
from clustermcl.runtime.logs import CauseCounter
from clustermcl.runtime.output_files import replace_file, write_over
from clustermcl.runtime.threads import disk_thread

MAX_FILE_BYTES = max_bytes(Checkpoint) + 1_024
SYNC_EVERY_S = 1.0
"""A power cut loses at most this time; a killed process loses nothing that was written [s]."""
LAST_WRITE_S = 0.4
"""Longest wait for the disk at the end [s]."""

_log = logging.getLogger(__name__)


@cache
def files_of(folder: Path, robot: str) -> tuple[Path, Path, Path]:
    """Return the file that survives a power cut, and the two for states since."""
    file = folder / f"state-{quote(robot, safe='')}.msgpack"
    return file, Path(f"{file}.0"), Path(f"{file}.1")


def read(folder: Path, robot: str) -> Checkpoint | None:
    """Return the newest state in a robot's files; None: all are missing, unreadable or invalid."""
    found = filter(None, map(_read, files_of(folder, robot)))
    return max(found, key=lambda checkpoint: checkpoint.rank, default=None)


def _read(path: Path) -> Checkpoint | None:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
        if len(data) > MAX_FILE_BYTES:
            raise ValueError(f"larger than {MAX_FILE_BYTES} bytes")
        checkpoint = decode(without_checksum(data), Checkpoint)
        check_term(checkpoint, time.time_ns())
        state_in(checkpoint)
    except FileNotFoundError:
        return None
    except (OSError, ValueError, MalformedMessageError) as error:
        _log.warning("the state in %s is not used: %s", path, error)
        return None
    return checkpoint


def write(folder: Path, robot: str, checkpoint: Checkpoint, *, sync: bool) -> None:
    """Write a state; create the folder if it is missing.

    With `sync`, wait until the state is on the disk, so that it survives a power cut.

    Raises:
        OSError: the folder cannot be written, or the disk is full; earlier states are kept.
    """
    target, *recent = files_of(folder, robot)
    content = with_checksum(encode(checkpoint))
    if sync:
        replace_file(target, content)
        return
    # A rename, or an empty file, would make some file systems begin to write.
    path = recent[checkpoint.serial % 2]
    earlier = path.read_bytes() if path.exists() else b""
    try:
        write_over(path, content)
    except OSError:  # the earlier state still has its room on the disk
        write_over(path, earlier)
        raise


class StateKeeper:
    """Writes the newest state in a separate thread, so a slow disk delays no belief.

    Only a state of a higher rank replaces `kept`, the state in the files. Without a `folder` no
    state is written.
    """

    def __init__(self, folder: Path | None, robot: str, kept: Checkpoint | None) -> None:
        self._folder, self._robot = folder, robot
        self._rank = kept.rank if kept else None
        self._changed, self._newest = threading.Event(), deque[Checkpoint](maxlen=1)
        self._closed, self._causes = False, CauseCounter()
        self._term: int | None = None

    def offer(self, checkpoint: Checkpoint) -> None:
        """Write a state soon, if its rank is higher than that of the last one.

        Call it before the state is published. The first state of a term is written immediately:
        once workers have received the term, an older file does not count.
        """
        if self._folder is None or (self._rank is not None and checkpoint.rank <= self._rank):
            return
        self._rank = checkpoint.rank
        if checkpoint.term != self._term:
            self._term = checkpoint.term
            self._write(self._folder, checkpoint, sync=False)
            return
        self._newest.append(checkpoint)
        self._changed.set()

    def running(self) -> AbstractContextManager[None]:
        """Write within the ``with`` block; at its end write the newest state, and wait a moment."""
        if self._folder is None:
            return nullcontext()
        return disk_thread(partial(self._run, self._folder), "state", self._close, LAST_WRITE_S)

    def _close(self) -> None:
        self._closed = True
        self._changed.set()

    def _run(self, folder: Path) -> None:
        sync_at_s, unsynced, closed = time.monotonic(), None, False
        while not closed:
            self._changed.wait(max(sync_at_s - time.monotonic(), 0.0) if unsynced else None)
            self._changed.clear()
            closed = self._closed
            checkpoint = self._newest.pop() if self._newest else unsynced
            if checkpoint is not None:
                sync = closed or time.monotonic() >= sync_at_s
                if closed:  # first where no slow disk is waited for
                    self._write(folder, checkpoint, sync=False)
                self._write(folder, checkpoint, sync=sync)
                unsynced = None if sync else checkpoint
                if sync:
                    sync_at_s = time.monotonic() + SYNC_EVERY_S

    def _write(self, folder: Path, checkpoint: Checkpoint, *, sync: bool) -> None:
        """Write a state. On a full disk one with `sync` fails, and one written over another not."""
        try:
            write(folder, self._robot, checkpoint, sync=sync)
        except OSError as error:
            cause = f"the state cannot be kept in {folder}"
            self._causes.warn(_log, cause, error, time.monotonic())
