"""Writes the last pose now and then, in a thread of its own: a slow disk delays no belief."""

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from coordinator import last_pose_files
from coordinator.pose.last_pose import LastPose

_log = logging.getLogger(__name__)


class PoseKeeper:
    """Holds the newest pose until it is written.

    Args:
        folder: where to; None: nowhere.
        robot: whose poses.
        every_s: the least time between two writes.
    """

    def __init__(self, folder: Path | None, robot: str, every_s: float) -> None:
        self._folder, self._robot, self._every_s = folder, robot, every_s
        self._changed = threading.Condition()
        self._newest: LastPose | None = None
        self._closed = self._failed = False

    def offer(self, pose: LastPose) -> None:
        """A newer pose, to be written when it is time."""
        if self._folder is not None:
            with self._changed:
                self._newest = pose
                self._changed.notify()

    @contextmanager
    def running(self) -> Iterator[None]:
        """Write while the context lasts; what is newest is written on the way out."""
        if self._folder is None:
            yield
            return
        thread = threading.Thread(target=self._run, args=(self._folder,), name="pose-keeper")
        thread.start()
        try:
            yield
        finally:
            with self._changed:
                self._closed = True
                self._changed.notify()
            thread.join()

    def _run(self, folder: Path) -> None:
        last_pose_files.remove_leftovers(folder, self._robot, time.time())
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._newest is not None)
                pose, self._newest = self._newest, None
            if pose is not None:
                self._write(folder, pose)
            with self._changed:
                if self._changed.wait_for(lambda: self._closed, self._every_s):
                    break
        if self._newest is not None:
            self._write(folder, self._newest)

    def _write(self, folder: Path, pose: LastPose) -> None:
        """Write; a disk that cannot be written is told once, and tried again."""
        try:
            last_pose_files.write(folder, self._robot, pose)
            self._failed = False
        except OSError as error:
            if not self._failed:
                _log.warning("the last pose cannot be kept in %s: %s", folder, error)
            self._failed = True
