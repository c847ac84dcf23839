"""What all messages have in common, and poses as they travel.

All are frozen structures that `protocol.codec` turns into MessagePack maps and back. A field
never changes its name, type or unit; a new field has a default; anything else is a new version.
Each tells who sends it where, who reads it, and what losing it costs. Keys stand relative to the
robot's namespace; see `protocol.keys`.
"""

from typing import TypeAlias

import msgspec

PoseTuple: TypeAlias = tuple[float, float, float]
"""x [m], y [m], heading [rad]."""
Circle: TypeAlias = tuple[float, float, float]
"""x [m], y [m], radius [m]."""
Corners: TypeAlias = tuple[tuple[float, float], ...]
"""x [m], y [m] of each: two of a rectangle, more of a polygon; none: of nothing."""
Covariance: TypeAlias = tuple[float, float, float, float, float, float, float, float, float]
"""3 x 3, row by row, over x [m], y [m], heading [rad]."""

MAX_POSE_M = 1e8
"""A coordinate beyond it is no place on Earth, in whatever frame."""


class Message(msgspec.Struct, frozen=True, kw_only=True, tag_field="schema"):
    """What all messages have in common."""

    sender: str
    """Name of the process that speaks."""
