"""Time and frame of a ROS message's header."""

from typing import Any

LAST_NS = 2**31 * 1_000_000_000 - 1
"""ROS's seconds have 31 bits [ns]."""


def stamp_of(header: Any) -> int:
    """Return the time in a message's header [ns].

    Raises:
        ValueError: the stamp is not a valid ROS time.
    """
    stamp_ns = nanoseconds(header.stamp)
    if problem := time_problem(stamp_ns):
        raise ValueError(problem)
    return stamp_ns


def nanoseconds(time: Any) -> int:
    """Convert a `builtin_interfaces/Time` to nanoseconds."""
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


def time_problem(time_ns: int) -> str:
    """Return why this is not a valid ROS time; empty: it is valid."""
    if 0 <= time_ns <= LAST_NS:
        return ""
    return f"a time of {time_ns / 1e9:.9g} s is not between 0 and {LAST_NS // 10**9} s"


def frame_name(name: str) -> str:
    """Return a frame's name without ROS 1's leading slash."""
    return name.removeprefix("/")
