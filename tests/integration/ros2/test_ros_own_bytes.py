"""Our messages against ROS's own: rclpy of each release reads ours, and writes the same bytes.

`.ci/run` installs rclpy and sets ROS_PYTHONS; without it these tests are skipped.
"""

import dataclasses
import itertools
import json
import os
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype

from clustermcl.ros2 import message_types as types
from clustermcl.ros2.message_types import decode, encode, new, typestore
from tests.unit.ros2.test_message_types import HALVES, MESSAGES

PROGRAM = Path(__file__).parent / "programs" / "ros_bytes.py"
FILLER = "structure_needs_at_least_one_member"
"""The one byte of what is empty; rclpy does not show it."""
NUMPY_NAMES = {"byte": "uint8", "octet": "uint8", "char": "uint8"}
PYTHONS = [path for path in os.environ.get("ROS_PYTHONS", "").split(os.pathsep) if path]

NOT_PACKED = (
    "tf2_msgs",
    "nav2_msgs",
    "visualization_msgs",
    "diagnostic_msgs",
    "vision_msgs",
    "bond",
    "apriltag_msgs",
)
"""Not among the packages for Python: another implementation that knows them by their text writes
them. Its definitions are right, for their hashes are those on the wire."""
POSE_REQUEST = types.request_of(types.SET_INITIAL_POSE)
LIKE = {
    types.request_of(types.EMPTY): types.request_of(types.GET_STATE),
    types.response_of(types.EMPTY): types.request_of(types.GET_STATE),
    types.request_of(types.TRIGGER): types.request_of(types.GET_STATE),
    types.response_of(types.TRIGGER): "rcl_interfaces/msg/SetParametersResult",
    POSE_REQUEST: types.POSE_STAMPED,
    types.response_of(types.SET_INITIAL_POSE): types.request_of(types.GET_STATE),
}
"""Not packed either, but these have the same fields in the same order."""

pytestmark = pytest.mark.skipif(not PYTHONS, reason="no rclpy: see .ci/run")


@cache
def answers(python: str) -> dict[str, dict[str, Any]]:
    """One release's bytes of all messages."""
    asked = "".join(
        json.dumps(
            {
                "type": LIKE.get(ros_type, ros_type),
                "values": values(message.pose if ros_type == POSE_REQUEST else message),
                "bytes": encode(message, ros_type).hex(),
                "definition": typestore().generate_msgdef(ros_type, ros_version=2)[0],
            }
        )
        + "\n"
        for ros_type, message in MADE.items()
    )
    ended = subprocess.run(
        [python, "-I", str(PROGRAM)],
        input=asked, capture_output=True, text=True, timeout=100, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    lines = map(json.loads, ended.stdout.splitlines())
    return dict(zip(MADE, lines, strict=True))


def full(ros_type: str) -> Any:
    """A message with something in every field; texts end at all places of a word."""
    return _full(ros_type, itertools.count(1))


def _full(ros_type: str, numbers: Iterator[int]) -> Any:
    fields = typestore().fielddefs[ros_type][1]
    return new(
        ros_type, **{name: _filled(kind, numbers) for name, kind in fields if name != FILLER}
    )


def _filled(kind: Any, numbers: Iterator[int]) -> Any:
    node, about = kind
    if node == Nodetype.NAME:
        return _full(about, numbers)
    if node != Nodetype.BASE:
        inner, length = about
        items = [_filled(inner, numbers) for _ in range(length or 3)]
        is_text = inner[0] != Nodetype.BASE or inner[1][0] == "string"
        return items if is_text else np.array(items, NUMPY_NAMES.get(inner[1][0], inner[1][0]))
    number, name = next(numbers), about[0]
    if name == "string":
        return "a" * (number % 9 + 1)
    if name == "bool":
        return True
    return number + 0.5 if name.startswith("float") else number % 100


def values(message: Any) -> Any:
    """The fields' values in their order, as JSON has them."""
    if isinstance(message, np.ndarray):
        return message.tolist()
    if isinstance(message, list):
        return [values(one) for one in message]
    if not dataclasses.is_dataclass(message):
        return message
    fields: list[Any] = typestore().fielddefs[message.__msgtype__][1]  # type: ignore[attr-defined] # the library's
    return [values(getattr(message, name)) for name, _ in fields if name != FILLER]


MADE = {ros_type: full(ros_type) for ros_type in (*MESSAGES, *HALVES)}


@pytest.mark.parametrize("ros_type", MADE)
@pytest.mark.parametrize("python", PYTHONS)
def test_ros_writes_the_same_bytes_and_reads_ours(python: str, ros_type: str) -> None:
    answer, ours = answers(python)[ros_type], encode(MADE[ros_type], ros_type)
    assert answer["by"] == (
        "mcap_ros2" if LIKE.get(ros_type, ros_type).startswith(NOT_PACKED) else "rclpy"
    )
    assert answer["read_alike"]
    theirs = bytes.fromhex(answer["bytes"])
    assert encode(decode(theirs, ros_type), ros_type) == ours
    # ROS leaves what was in memory between the fields and at the end; we write zeros.
    assert 0 <= len(theirs) - len(ours) < 4
    differing = [i for i, (a, b) in enumerate(zip(ours, theirs, strict=False)) if a != b]
    assert all(ours[i] == 0 for i in differing)
