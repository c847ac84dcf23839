"""Time and frame of a ROS message's header."""

from typing import Any

LAST_NS = 2**31 * 1_000_000_000 - 1
"""ROS's seconds have 31 bits [ns]."""


def time_of(time: Any) -> int:
    """Convert a `builtin_interfaces/Time` to nanoseconds.

    Raises:
        ValueError: it is not a valid ROS time.
    """
    time_ns = nanoseconds(time)
    if not 0 <= time_ns <= LAST_NS:
        last_s = LAST_NS // 10**9
        raise ValueError(f"a time of {time_ns / 1e9:.9g} s is not between 0 and {last_s} s")
    return time_ns


def nanoseconds(time: Any) -> int:
    """Convert a `builtin_interfaces/Time` to nanoseconds, unchecked."""
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


def frame_name(name: str) -> str:
    """Return a frame's name without ROS 1's leading slash."""
    return name.removeprefix("/")
