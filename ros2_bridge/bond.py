"""The sign of life that nav2's lifecycle manager wants ten times a second.

If it is silent for four seconds, nav2 shuts down all of its nodes. So it has a thread of its own,
which does nothing else.
"""

import threading
import time
import uuid
from typing import Protocol

from ros2_bridge.message_types import BOND_STATUS, new
from ros2_bridge.messages_out import header

PERIOD_S, TIMEOUT_S = 0.1, 4.0


class Sender(Protocol):
    """What sends messages of the topic `bond`."""

    def put(self, message: object) -> None:
        """Send a `bond/Status`."""


class BondThread:
    """Sends as long as it is begun; use it in a ``with`` block.

    Args:
        publisher: of the topic `bond`.
        node_name: the bond's name is the node's.
    """

    def __init__(self, publisher: Sender, node_name: str) -> None:
        self._publisher, self._node_name = publisher, node_name
        self.instance_id = ""
        """Of the bond that was begun last."""
        self._over: threading.Event | None = None
        self._thread: threading.Thread | None = None

    def __enter__(self) -> "BondThread":
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def begin(self, instance_id: str = "") -> None:
        """Begin a bond, or go on with a killed bridge's; nothing, if there is one."""
        if self._thread is None:
            self._over = threading.Event()
            self.instance_id = instance_id or str(uuid.uuid4())
            arguments = (self._over, self.instance_id)
            self._thread = threading.Thread(target=self._send, args=arguments, name="bond")
            self._thread.start()

    def end(self) -> None:
        """Break the bond, and say so."""
        if self._over is not None and self._thread is not None:
            self._over.set()
            self._thread.join()
            self._over = self._thread = None

    def _send(self, over: threading.Event, instance_id: str) -> None:
        def status(*, active: bool) -> object:
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
            self._publisher.put(status(active=True))
            next_s = max(next_s + PERIOD_S, time.monotonic())
        self._publisher.put(status(active=False))
