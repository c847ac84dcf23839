"""The process's log on ROS's topic `/rosout`."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import zenoh

from ros2_bridge.message_types import LOG, new
from ros2_bridge.messages_out import header
from ros2_bridge.node import RosPublisher

_LEVELS = (10, 20, 30, 40, 50)
"""Of ROS, and of Python."""


class _RosLog(logging.Handler):
    def __init__(self, publisher: RosPublisher, name: str) -> None:
        super().__init__(logging.INFO)
        self._publisher, self._name = publisher, name

    def emit(self, record: logging.LogRecord) -> None:
        told = new(
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
            self._publisher.put(told)


@contextmanager
def log_to_ros(publisher: RosPublisher, node: str) -> Iterator[None]:
    """Also publish what is logged, while the context lasts.

    Args:
        publisher: of `/rosout`.
        node: its full name; its logger's has dots.
    """
    handler = _RosLog(publisher, node.strip("/").replace("/", "."))
    logging.getLogger().addHandler(handler)
    try:
        yield
    finally:
        logging.getLogger().removeHandler(handler)
