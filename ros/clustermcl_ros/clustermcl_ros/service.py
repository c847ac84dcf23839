"""The engine that is a system of processes: one that runs, or one that the node starts."""

import logging
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager

from msgspec.structs import replace

from clustermcl.commands.stack import ProcessEndedError, Stack, temporary_folder
from clustermcl.link.node import Node
from clustermcl.protocol import keys
from clustermcl.ros2.port import Port
from clustermcl.ros2.service_engine import ServiceEngine
from clustermcl.runtime.settings import Settings, ZenohSettings
from clustermcl.runtime.stop import StopFlag

_TURN_S = 0.1

_log = logging.getLogger(__name__)


class SystemEngine(ServiceEngine):
    """A `ServiceEngine` with a loop, which also restarts the processes of a stack."""

    def __init__(self, node: Node, port: Port, stack: Stack | None) -> None:
        super().__init__(node, port)
        self._stack = stack

    def run(self, stop: StopFlag) -> None:
        """Run until `stop` is set.

        Raises:
            ProcessEndedError: a process of the stack refuses to start.
        """
        self._node.stop = stop
        if self._stack is not None:
            self._stack.start_all()
        with closing(self._node):
            self._node.open()
            while not stop.is_set():
                self.turn(_TURN_S)
                if self._stack is not None:
                    _restart_ended(self._stack)


def _restart_ended(stack: Stack) -> None:
    for ended in stack.supervisor.poll(time.monotonic()):
        if ended.restart_in_s is None:
            raise ProcessEndedError(ended)
        again = f"starting it again in {ended.restart_in_s:.1f} s"
        _log.warning("%s ended with code %d; %s", ended.name, ended.code, again)


@contextmanager
def system_engine(settings: Settings, port: Port) -> Iterator[SystemEngine]:
    """Return an engine that stands before the system at the setting `zenoh.router`.

    With that setting unchanged, it starts a system whose router listens at a Unix socket in a
    folder of its own, so that nothing listens at a port.
    """
    with ExitStack() as resources:
        stack = None
        if settings.zenoh.router == ZenohSettings().router:
            folder = resources.enter_context(temporary_folder())
            zenoh = replace(settings.zenoh, router=f"unixsock-stream/{folder}/router.sock")
            bridge = replace(settings.bridge, map=settings.bridge.map or "zenoh")
            settings = replace(settings, zenoh=zenoh, bridge=bridge)
            stack = resources.enter_context(closing(Stack(settings, folder, logs_in_folder=False)))
        node = Node("amcl", "ros2", settings, StopFlag(), peers=keys.COORDINATOR_ALIVE)
        yield SystemEngine(node, port, stack)
