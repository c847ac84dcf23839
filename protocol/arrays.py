"""Numeric arrays on the wire: one little-endian blob with its dtype and shape."""

import math
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from protocol.errors import MalformedMessageError

WireType = Literal["int8", "float32", "float64"]


class ArrayBlob(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An array as bytes: C order, little-endian."""

    dtype: WireType
    shape: tuple[int, ...]
    data: bytes

    @classmethod
    def of(cls, array: NDArray[Any], dtype: WireType) -> "ArrayBlob":
        """Pack an array, converted to the wire type `dtype`."""
        little = np.ascontiguousarray(array, dtype=np.dtype(dtype).newbyteorder("<"))
        return cls(dtype=dtype, shape=little.shape, data=little.tobytes())

    def array(self) -> NDArray[Any]:
        """The array, read-only and without a copy.

        Raises:
            MalformedMessageError: the bytes do not fill the shape.
        """
        dtype = np.dtype(self.dtype).newbyteorder("<")
        if any(side < 0 for side in self.shape) or (
            math.prod(self.shape) * dtype.itemsize != len(self.data)
        ):
            problem = f"{len(self.data)} bytes do not make {self.dtype} of shape {self.shape}"
            raise MalformedMessageError(expected="array", problem=problem)
        return np.frombuffer(self.data, dtype=dtype).reshape(self.shape)
