"""The base class of all messages, and poses on the wire.

Messages are frozen structures that `protocol.codec` encodes as MessagePack maps. A field never
changes its name, type or unit; a new field has a default; any other change is a new version.
Each docstring names sender, key, readers and the cost of a loss. Keys are relative to the robot's
namespace; see `protocol.keys`.
"""

from typing import TypeAlias

import msgspec

PoseTuple: TypeAlias = tuple[float, float, float]
"""x [m], y [m], heading [rad]."""
Circle: TypeAlias = tuple[float, float, float]
"""x [m], y [m], radius [m]."""
Corners: TypeAlias = tuple[tuple[float, float], ...]
"""x [m], y [m] of each: two corners of a rectangle, or those of a polygon; empty: no region."""
Covariance: TypeAlias = tuple[float, float, float, float, float, float, float, float, float]
"""3 x 3, row by row, over x [m], y [m], heading [rad]."""

MAX_POSE_M = 1e8
"""Limit for coordinates: in any frame, a place on Earth is nearer."""


class Message(msgspec.Struct, frozen=True, kw_only=True, tag_field="schema"):
    """Base class of all messages."""

    sender: str
    """Name of the sending process."""
