"""The heartbeat that nav2's lifecycle manager expects, and the state kept for a restart.

If the heartbeat stops for four seconds, nav2 shuts down and restarts all of its nodes. So a
separate thread sends it ten times a second. If a killed bridge restarts within four seconds, it
continues in the same state with the same bond. If it restarts later, it starts unconfigured, as
the manager then expects.
"""

import logging
import os
import threading
import time
import uuid
from collections.abc import Callable
from typing import Any
from urllib.parse import quote

import msgspec

from clustermcl.protocol.conversion import decoded
from clustermcl.ros2.message_types import BOND_STATUS, new
from clustermcl.ros2.messages_out import header
from clustermcl.ros2.port import State
from clustermcl.runtime.folders import state_folder

PERIOD_S, TIMEOUT_S = 0.1, 4.0


class BondThread:
    """Sends heartbeats between `begin` and `end`."""

    def __init__(self, publish: Callable[[Any], object], node_name: str) -> None:
        self._publish, self._node_name = publish, node_name
        self.instance_id = ""
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def begin(self, instance_id: str = "") -> None:
        """Begin a bond, or continue that of a killed bridge; this has no effect during a bond."""
        if self._thread is None:
            self._over = threading.Event()
            self.instance_id = instance_id or str(uuid.uuid4())
            arguments = (self._over, self.instance_id)
            self._thread = threading.Thread(target=self._send, args=arguments, name="bond")
            self._thread.start()

    def end(self) -> None:
        if self._thread is not None:
            self._over.set()
            self._thread.join()
            self._thread = None

    def _send(self, over: threading.Event, instance_id: str) -> None:
        def status(*, active: bool) -> Any:
            return new(
                BOND_STATUS,
                header=header(time.time_ns(), ""),
                id=self._node_name,
                instance_id=instance_id,
                active=active,
                heartbeat_timeout=TIMEOUT_S,
                heartbeat_period=PERIOD_S,
            )

        next_s = time.monotonic()
        while not over.wait(max(0.0, next_s - time.monotonic())):
            self._publish(status(active=True))
            next_s = max(next_s + PERIOD_S, time.monotonic())
        self._publish(status(active=False))


_EVERY_S = 0.5
_MAX_BYTES = 1024

_log = logging.getLogger(__name__)


class BridgeState(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The state of a bridge."""

    state: State
    bond: str
    """The bond's instance id; the manager treats a new id as another node."""
    held: int | None


class RestartFile:
    """Exists while the node runs and after it was killed, in the coordinator's state folder."""

    def __init__(self, folder_setting: str, node: str) -> None:
        folder = state_folder(folder_setting)
        self._path = folder and folder / f"ros2-{quote(node, safe='')}.json"
        self._kept: BridgeState | None = None
        self._again_s = 0.0

    def remove(self) -> None:
        if self._path is not None:
            self._path.unlink(missing_ok=True)

    def read(self) -> BridgeState | None:
        """Return the state of a bridge killed within `TIMEOUT_S`; None: there is none."""
        path = self._path
        try:
            if path is None or not path.is_file():
                return None
            with path.open("rb") as file:
                age_s = time.time() - os.fstat(file.fileno()).st_mtime
                before = decoded(file.read(_MAX_BYTES), BridgeState, msgspec.json)
        except (OSError, msgspec.DecodeError) as error:
            _log.warning("%s is not used: %s", path, error)
            return None
        return before if 0.0 <= age_s < TIMEOUT_S else None

    def keep(self, bridge_state: BridgeState, now_s: float) -> None:
        """Write a changed state; update the file's time twice a second."""
        if self._path is None or (bridge_state == self._kept and now_s < self._again_s):
            return
        try:
            if bridge_state == self._kept:
                os.utime(self._path)
            else:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                part = self._path.with_suffix(".part")
                part.write_bytes(msgspec.json.encode(bridge_state))
                part.replace(self._path)
        except OSError as error:
            _log.warning("a killed bridge will start unconfigured: %s", error)
            self._path = None
        self._kept, self._again_s = bridge_state, now_s + _EVERY_S
