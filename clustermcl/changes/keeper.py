"""Collects the changes of a running robot, and keeps them in a file across restarts."""

import logging
import threading
import time
from pathlib import Path
from urllib.parse import quote

from clustermcl.changes.collector import ChangeCollector
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.changes import KeptChanges
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.conversion import with_checksum, without_checksum
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.steps import Scan
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.runtime.output_files import replace_file

SAVE_EVERY_S = 60.0
"""A killed process loses at most what was collected in this time [s]."""

_log = logging.getLogger(__name__)


class ChangeKeeper:
    """The changes in one map. `on_step` is called in the loop, `renew` in any one thread.

    A folder of None: nothing is kept.
    """

    def __init__(self, grid_map: GridMap, folder: Path | None, robot: str, sender: str) -> None:
        self._collector, self._sender = ChangeCollector(grid_map), sender
        self._file = folder and folder / f"changes-{quote(robot, safe='')}.msgpack"
        self._saved_s, self._saving = time.monotonic(), threading.Lock()
        if self._file is not None:
            self._read(self._file)
        self.newest = self._collector.changes(sender)

    def _read(self, path: Path) -> None:
        most = KeptChanges.max_bytes + 1_024
        try:
            with path.open("rb") as file:
                data = file.read(most + 1)
            self._collector.restore(decode(without_checksum(data), KeptChanges))
        except FileNotFoundError:
            return
        except (OSError, ValueError, MalformedMessageError) as error:
            _log.warning("the changes in %s are not used: %s", path, error)

    def on_step(self, scan: Scan, belief: Belief) -> None:
        self._collector.on_step(scan, belief.state, scan.floors.drawn(belief).hypotheses)

    def renew(self) -> bool:
        """Renew `newest`, and write the file if it is due; return whether cells have changed."""
        before = self.newest.cells.array()[:, :2].tobytes()
        self.newest = self._collector.changes(self._sender)
        if time.monotonic() - self._saved_s > SAVE_EVERY_S:
            self.save()
        return self.newest.cells.array()[:, :2].tobytes() != before

    def save(self) -> None:
        self._saved_s = time.monotonic()
        if self._file is not None:
            try:
                with self._saving:  # at the bridge's end, `renew` may be at it in its thread
                    replace_file(self._file, with_checksum(encode(self._collector.kept)))
            except OSError as error:
                _log.warning("changes cannot be kept in %s: %s", self._file, error)
