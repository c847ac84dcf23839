"""Writes ROS messages as a rosbag2 in one MCAP file, which ROS's tools and Foxglove open.

The library `mcap` writes the file, `rosbags` knows the messages (extra ``ros2``).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from process_runtime.output_files import OutputError, check_output_file
from recordings.bag_file import definitions

_CHUNK_BYTES = 2**18
"""Of a recorder that is killed, so much is lost at most."""


class BagWriter:
    """A bag that is written; use it in a ``with`` block.

    Args:
        path: of the file; one that is there is written over.

    Attributes:
        types: the classes of messages, by their names such as ``nav_msgs/msg/Odometry``.

    Raises:
        OutputError: the libraries are not installed, or the file cannot be written; so for all.
    """

    def __init__(self, path: Path) -> None:
        check_output_file(path)
        try:
            from mcap.writer import Writer  # noqa: PLC0415 - an extra

            self._store = definitions(ros1=False)
        except ImportError as missing:
            problem = "to write it, install the extra: pip install 'clustermcl[ros2]'"
            raise OutputError(path=path, problem=problem) from missing
        self._path = path
        self.types: dict[str, Any] = self._store.types
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        with self._told():
            self._file = path.open("wb")
            self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES)
            self._writer.start(profile="ros2", library="clustermcl")

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(self, *_how: object) -> None:
        with self._told(), self._file:
            self._writer.finish()  # type: ignore[no-untyped-call] # the library's

    def write(self, topic: str, message: Any, time_ns: int) -> None:
        """Append a message.

        Args:
            topic: with one type of messages.
            message: made of one of `types`.
            time_ns: when it was recorded.
        """
        kind = message.__msgtype__
        with self._told():
            if topic not in self._channels:
                schema = self._schema(kind)
                self._channels[topic] = self._writer.register_channel(topic, "cdr", schema)
            data = bytes(self._store.serialize_cdr(message, kind))
            at_ns = max(time_ns, 0)
            self._writer.add_message(self._channels[topic], at_ns, data, at_ns)

    def _schema(self, kind: str) -> int:
        if kind not in self._schemas:
            text, _ = self._store.generate_msgdef(kind, ros_version=2)
            self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", text.encode())
        return self._schemas[kind]

    @contextmanager
    def _told(self) -> Iterator[None]:
        """What the disk refuses, in one line."""
        try:
            yield
        except OSError as error:
            problem = error.strerror or str(error)
            raise OutputError(path=self._path, problem=problem) from error
