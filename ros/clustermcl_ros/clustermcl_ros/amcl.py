"""The process of AMCL's node. All its arguments are those of ROS: `--ros-args ...`."""

import logging
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from typing import NoReturn, cast

import rclpy
from rclpy.exceptions import NameValidationException
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions

from clustermcl.protocol.causes import Cause
from clustermcl.protocol.errors import ClusterMclError
from clustermcl.ros2 import message_types
from clustermcl.ros2.bond import RestartFile
from clustermcl.ros2.port import Port, State
from clustermcl.runtime.main import Invocation, process_main
from clustermcl.runtime.stop import StopFlag
from clustermcl.runtime.threads import run_in_threads
from clustermcl_ros import messages
from clustermcl_ros.inside import InsideEngine
from clustermcl_ros.node import AmclNode, Relay
from clustermcl_ros.service import SystemEngine, system_engine

_TICK_S = 0.1

_log = logging.getLogger(__name__)


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Run the node until SIGINT or SIGTERM; `argv` as `sys.argv`."""
    of_ros = list(sys.argv if argv is None else argv)
    sys.argv = of_ros[:1]
    process_main("amcl", partial(_run, of_ros), describe="Cluster-MCL in place of nav2's AMCL.")


def _run(of_ros: list[str], invocation: Invocation) -> None:
    message_types.use(messages.new)
    with ExitStack() as resources:
        try:
            rclpy.init(args=of_ros, signal_handler_options=SignalHandlerOptions.NO)
            resources.callback(rclpy.try_shutdown)
            node = AmclNode(invocation.settings)
            resources.callback(node.end)
            logging.getLogger().handlers[:] = [_RosLog(node)]
            relay = cast(Port, Relay(node))
            engine: InsideEngine | SystemEngine
            if node.engine == "inside":
                engine = InsideEngine(node.settings, relay)
            else:
                engine = resources.enter_context(system_engine(node.settings, relay))
            node.begin(engine)
        except (rclpy_implementation.RCLError, NameValidationException) as error:
            raise ClusterMclError(str(error)) from None
        middleware = rclpy.get_rmw_implementation_identifier()
        _log.info("%s is running over %s, engine %s", node.full_name, middleware, node.engine)
        domain = node.context.get_domain_id()
        file = RestartFile(node.settings.coordinator.state_folder, f"{domain}{node.full_name}")
        resources.callback(file.remove)
        run_in_threads([partial(_spin, node, file), engine.run], invocation.stop)


def _spin(node: AmclNode, file: RestartFile, stop: StopFlag) -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    before = file.read()
    if before is not None and before.state in (State.INACTIVE, State.ACTIVE):
        node.resume(before)
    elif node.settings.ros2.autostart:
        node.trigger_configure()
        node.trigger_activate()
    tick_s = 0.0
    while not stop.is_set():
        try:
            executor.spin_once(timeout_sec=max(tick_s - time.monotonic(), 0.0))
        except (rclpy_implementation.RCLError, UnicodeDecodeError) as error:
            node.refuse(Cause.NOT_ROS, str(error))
        if (now_s := time.monotonic()) >= tick_s:
            tick_s = now_s + _TICK_S
            node.port.tick()
            file.keep(node.kept_state, now_s)


class _RosLog(logging.Handler):
    """Passes the log to ROS, which wants a line of its own for each severity."""

    def __init__(self, node: AmclNode) -> None:
        super().__init__(logging.INFO)
        self._logger = node.get_logger()

    def emit(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        if record.levelno >= logging.ERROR:
            self._logger.error(text)
        elif record.levelno >= logging.WARNING:
            self._logger.warning(text)
        else:
            self._logger.info(text)


if __name__ == "__main__":
    main()
