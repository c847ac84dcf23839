"""The heartbeat that nav2's lifecycle manager expects ten times a second.

If it stops for four seconds, nav2 shuts down all of its nodes. So it has its own thread.
"""

import threading
import time
import uuid
from typing import Protocol

from ros2_bridge.message_types import BOND_STATUS, new
from ros2_bridge.messages_out import header

PERIOD_S, TIMEOUT_S = 0.1, 4.0


class Sender(Protocol):
    """Publisher of the topic `bond`."""

    def put(self, message: object) -> None:
        """Send a `bond/Status`."""


class BondThread:
    """Sends heartbeats between `begin` and `end`; a context manager that ends them.

    Args:
        publisher: of the topic `bond`.
        node_name: name of the node and of its bond.
    """

    def __init__(self, publisher: Sender, node_name: str) -> None:
        self._publisher, self._node_name = publisher, node_name
        self.instance_id = ""
        """Id of the newest bond."""
        self._over: threading.Event | None = None
        self._thread: threading.Thread | None = None

    def __enter__(self) -> "BondThread":
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def begin(self, instance_id: str = "") -> None:
        """Begin a bond, or continue that of a killed bridge; no effect during a bond."""
        if self._thread is None:
            self._over = threading.Event()
            self.instance_id = instance_id or str(uuid.uuid4())
            arguments = (self._over, self.instance_id)
            self._thread = threading.Thread(target=self._send, args=arguments, name="bond")
            self._thread.start()

    def end(self) -> None:
        """End the bond with a last message."""
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
