"""Numeric arrays on the wire: little-endian bytes with a dtype and a shape."""

import math
from typing import Any, Literal, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from clustermcl.protocol.errors import MalformedMessageError

WireType = Literal["int8", "int32", "float32", "float64"]

_LITTLE = {name: np.dtype(name).newbyteorder("<") for name in get_args(WireType)}

MAX_DIMENSIONS = 2
"""Scans have one, particle sets and maps two."""
MAX_SIDE = 2**31
"""Bounds an array whose other side is 0; otherwise the number of bytes bounds it."""


class ArrayBlob(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An array as bytes: C order, little-endian."""

    dtype: WireType
    shape: tuple[int, ...]
    data: bytes

    @classmethod
    def of(cls, array: NDArray[Any], dtype: WireType) -> "ArrayBlob":
        """Convert an array to `dtype` and pack it."""
        little = np.ascontiguousarray(array, dtype=_LITTLE[dtype])
        return cls(dtype=dtype, shape=little.shape, data=little.tobytes())

    def array(self) -> NDArray[Any]:
        """Return the array, read-only and without a copy; or raise a `MalformedMessageError`."""
        dtype = _LITTLE[self.dtype]
        if len(self.shape) > MAX_DIMENSIONS:
            raise _malformed(f"{len(self.shape)} dimensions; the limit is {MAX_DIMENSIONS}")
        if not all(0 <= side < MAX_SIDE for side in self.shape) or (
            math.prod(self.shape) * dtype.itemsize != len(self.data)
        ):
            raise _malformed(f"{len(self.data)} bytes do not fill {self.dtype} of {self.shape}")
        return np.frombuffer(self.data, dtype=dtype).reshape(self.shape)

    def checked(self, *shape: int | None, dtype: WireType | None = None) -> NDArray[Any]:
        """Return the array if its numbers are finite, and of this shape and type; None: any."""
        array = self.array()
        sides = zip(shape, array.shape, strict=False)
        fits = len(shape) == array.ndim and all(wanted in (None, side) for wanted, side in sides)
        if not fits or self.dtype != (dtype or self.dtype):
            raise _malformed(f"{self.dtype} of {self.shape}, expected {dtype or 'any'} of {shape}")
        if not np.isfinite(array).all():
            raise _malformed("a number that is not finite")
        return array


def _malformed(problem: str) -> MalformedMessageError:
    return MalformedMessageError(expected="array", problem=problem, kind="wrong array")
