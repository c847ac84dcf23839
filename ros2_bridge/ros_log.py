"""Publish the process's log on `/rosout`."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import zenoh

from ros2_bridge.message_types import LOG, new
from ros2_bridge.messages_out import header
from ros2_bridge.node import RosPublisher

_LEVELS = (10, 20, 30, 40, 50)
"""The same numbers in ROS and Python."""


class _RosLog(logging.Handler):
    def __init__(self, publisher: RosPublisher, name: str) -> None:
        super().__init__(logging.INFO)
        self._publisher, self._name = publisher, name

    def emit(self, record: logging.LogRecord) -> None:
        message = new(
            LOG,
            stamp=header(int(record.created * 1e9), "").stamp,
            level=max(level for level in _LEVELS if level <= record.levelno),
            name=self._name,
            msg=record.getMessage(),
            file=record.pathname,
            function=record.funcName or "",
            line=record.lineno,
        )
        with suppress(zenoh.ZError):  # the session is being closed
            self._publisher.put(message)


@contextmanager
def log_to_ros(publisher: RosPublisher, node: str) -> Iterator[None]:
    """Publish the log on `/rosout` too, within the ``with`` block.

    Args:
        publisher: of `/rosout`.
        node: full name of the node.
    """
    handler = _RosLog(publisher, node.strip("/").replace("/", "."))
    logging.getLogger().addHandler(handler)
    try:
        yield
    finally:
        logging.getLogger().removeHandler(handler)
