"""Numeric arrays on the wire: one little-endian blob with its dtype and shape."""

import math
from typing import Any, Literal, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from protocol.errors import MalformedMessageError

WireType = Literal["int8", "int32", "float32", "float64"]

_LITTLE = {name: np.dtype(name).newbyteorder("<") for name in get_args(WireType)}

MAX_DIMENSIONS = 2
"""Scans have one, clouds and maps two."""
MAX_SIDE = 2**31
"""Of an array that is empty in its other direction; else the bytes are the bound."""


class ArrayBlob(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An array as bytes: C order, little-endian."""

    dtype: WireType
    shape: tuple[int, ...]
    data: bytes

    @classmethod
    def of(cls, array: NDArray[Any], dtype: WireType) -> "ArrayBlob":
        """Pack an array, converted to the wire type `dtype`."""
        little = np.ascontiguousarray(array, dtype=_LITTLE[dtype])
        return cls(dtype=dtype, shape=little.shape, data=little.tobytes())

    def array(self) -> NDArray[Any]:
        """The array, read-only and without a copy.

        Raises:
            MalformedMessageError: the bytes do not fill the shape, or it is no array of ours.
        """
        dtype = _LITTLE[self.dtype]
        if len(self.shape) > MAX_DIMENSIONS:
            raise _malformed(f"{len(self.shape)} dimensions, at most {MAX_DIMENSIONS} are read")
        if not all(0 <= side < MAX_SIDE for side in self.shape) or (
            math.prod(self.shape) * dtype.itemsize != len(self.data)
        ):
            raise _malformed(f"{len(self.data)} bytes do not make {self.dtype} of {self.shape}")
        return np.frombuffer(self.data, dtype=dtype).reshape(self.shape)


def _malformed(problem: str) -> MalformedMessageError:
    return MalformedMessageError(expected="array", problem=problem, kind="array that lies")
