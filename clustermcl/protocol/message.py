"""The base class of all messages, and poses on the wire.

Messages are frozen structures that `clustermcl.protocol.codec` encodes as MessagePack maps. A field
never changes its name, type or unit; a new field has a default; any other change is a new version.
Each docstring names sender, key, readers and the cost of a loss. Keys are relative to the robot's
namespace; see `clustermcl.protocol.keys`.
"""

import math
import sys
from typing import Annotated, ClassVar, TypeAlias

import msgspec
from msgspec import Meta

MAX_POSE_M = 1e8
"""Limit for coordinates: in any frame, a place on Earth is nearer."""
MAX_STEP = 2**53
"""Limit for steps, epochs, terms and order numbers: 28 million years at 10 Hz."""
MAX_SCAN_STEP = 2**50
"""Limit for the steps of scans, so that numbers derived from them stay below `MAX_STEP`."""
MAX_ID_CHARACTERS = 128

SMALL_BYTES = 64 * 1024
"""Poses, commands and their answers; a few hundred bytes are usual."""
SCAN_BYTES = 256 * 1024
"""20,000 beams, more than any laser has, of eight bytes each."""
LIST_BYTES = 1024 * 1024
"""Hypotheses of thousands of clusters, the list of a thousand processes."""
LARGEST_BYTES = 32 * 1024 * 1024
"""A million particles; 300 scans of 20,000 beams; the map of a square kilometre, compressed."""

# Decoding refuses a number outside its type's range, NaN and infinity included.
Number: TypeAlias = Annotated[int, Meta(ge=0, lt=MAX_STEP)]
"""A step, epoch, term, order or count."""
NumberOrNone: TypeAlias = Annotated[int, Meta(ge=-1, lt=MAX_STEP)]
"""The same; -1: none."""
ScanStep: TypeAlias = Annotated[int, Meta(ge=0, lt=MAX_SCAN_STEP)]
Stamp: TypeAlias = Annotated[int, Meta(gt=-(2**62), lt=2**62)]
"""A robot's time [ns]."""
Finite: TypeAlias = Annotated[float, Meta(ge=-sys.float_info.max, le=sys.float_info.max)]
NotNegative: TypeAlias = Annotated[float, Meta(ge=0.0, le=sys.float_info.max)]
Positive: TypeAlias = Annotated[float, Meta(gt=0.0, le=sys.float_info.max)]
Coordinate: TypeAlias = Annotated[float, Meta(gt=-MAX_POSE_M, lt=MAX_POSE_M)]
Probability: TypeAlias = Annotated[float, Meta(ge=0.0, le=1.000001)]
"""With room for the rounding of sums."""
Id: TypeAlias = Annotated[str, Meta(min_length=1, max_length=MAX_ID_CHARACTERS)]

PoseTuple: TypeAlias = tuple[Coordinate, Coordinate, Finite]
"""x [m], y [m], heading [rad]."""
Circle: TypeAlias = tuple[Coordinate, Coordinate, Positive]
"""x [m], y [m], radius [m]."""
Corners: TypeAlias = tuple[tuple[Coordinate, Coordinate], tuple[Coordinate, Coordinate]]
"""x [m], y [m] of the lowest and the highest corner of a rectangle."""
Covariance: TypeAlias = tuple[
    NotNegative, Finite, Finite, Finite, NotNegative, Finite, Finite, Finite, NotNegative
]
"""3 x 3, row by row, over x [m], y [m], heading [rad]."""


class Message(msgspec.Struct, frozen=True, kw_only=True, tag_field="schema"):
    """Base class of all messages."""

    max_bytes: ClassVar[int] = SMALL_BYTES
    """A larger message is refused before it is copied or decoded."""

    sender: Annotated[str, Meta(max_length=MAX_ID_CHARACTERS)]
    """Name of the sending process."""


class Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base class of structures in messages that are refused with an unknown field."""


def ellipse_axes(xx: float, xy: float, yy: float) -> tuple[float, float, float]:
    """Return the long and the short standard deviation of a position, and the long one's direction.

    `xx` and `yy` are the variances of x and y, `xy` is their covariance [m²].
    """
    middle, apart = (xx + yy) / 2.0, math.hypot((xx - yy) / 2.0, xy)
    long_m, short_m = (math.sqrt(max(v, 0.0)) for v in (middle + apart, middle - apart))
    return long_m, short_m, 0.5 * math.atan2(2.0 * xy, xx - yy)
