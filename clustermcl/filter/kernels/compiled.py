"""The decorator of compiled functions, and checks of their arguments.

A kernel runs from the library of compiled kernels (see `kernel_library`), which needs no numba:
numba and LLVM take 130 MB of a process. Where there is no library, or it has no entry for these
types of arguments, numba compiles the kernel in each process.
`NUMBA_DISABLE_JIT=1` makes numba run every kernel as plain Python.
"""

import functools
from collections.abc import Callable
from functools import cached_property
from math import cos, sin
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import F, Pose, Poses
from clustermcl.filter.kernels import library as kernel_library


def kernel(function: F) -> F:
    """Compile `function` at its first call.

    Bounds are not checked and integers do not promote: kernels get checked arguments.
    ``fastmath`` stays off, so that results do not depend on how a loop was vectorised.
    """
    return cast(F, Kernel(function))


class Kernel:
    """A function, compiled for each tuple of types of arguments that it is called with."""

    def __init__(self, function: Callable[..., Any]) -> None:
        functools.update_wrapper(self, function)
        self.function = function
        self.compiled: dict[tuple[Any, ...], Callable[..., Any]] = {}

    def __call__(self, *arguments: Any) -> Any:
        types = tuple(map(_type_of, arguments))
        if (compiled := self.compiled.get(types)) is None:
            name = f"{self.function.__module__}.{self.function.__qualname__}{types}"
            if _record is not None:
                return _record(name, self.function, arguments)
            compiled = self.compiled[types] = (
                getattr(kernel_library.library(), name, None) or self.by_numba
            )
        return compiled(*arguments)

    @cached_property
    def by_numba(self) -> Any:
        """The kernel as numba's dispatcher, which compiles it for any types of arguments.

        Raises:
            NoKernelsError: numba is not installed.
        """
        try:  # 130 MB, only where the library does not do
            from numba import njit  # noqa: PLC0415
        except ModuleNotFoundError as error:
            raise kernel_library.NoKernelsError from error
        return njit(self.function, error_model="numpy", boundscheck=False)

    @property
    def _numba_type_(self) -> Any:
        """What numba takes this object for in a kernel that calls it."""
        from numba import typeof  # noqa: PLC0415

        return typeof(self.by_numba)


_record: Callable[[str, Callable[..., Any], tuple[Any, ...]], Any] | None = None
"""Called in place of all kernels while `called_in` runs."""


def called_in(run: Callable[[], None]) -> kernel_library.Entries:
    """Run a function with kernels as plain Python, and return which it called, and with what.

    It must be called before any kernel is.
    """
    entries: kernel_library.Entries = {}
    inside = False

    def record(name: str, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Call as plain Python; note the kernel unless another kernel calls it."""
        nonlocal inside
        if inside:
            return function(*arguments)
        from numba import typeof  # noqa: PLC0415

        entries[name] = function, tuple(map(typeof, arguments))
        inside = True
        result = function(*arguments)
        inside = False
        return result

    global _record  # noqa: PLW0603 - for this process, which then compiles them and ends
    _record = record
    run()
    _record = None
    return entries


_SCALARS = {
    float: "float", np.float64: "float", int: "int", np.int64: "int", bool: "bool", np.bool_: "bool"
}  # fmt: skip
_C_CONTIGUOUS, _ALIGNED, _WRITEABLE = 0x1, 0x100, 0x400
_LAYOUT = _C_CONTIGUOUS | _ALIGNED | _WRITEABLE


def _type_of(argument: Any) -> Any:
    """Return all that machine code depends on, as a value that compares and prints alike."""
    kind = type(argument)
    if name := _SCALARS.get(kind):
        return name
    if kind is np.ndarray:
        return argument.dtype.str, argument.ndim, argument.flags.num & _LAYOUT
    return kind.__name__, *map(_type_of, argument if isinstance(argument, tuple) else ())


ToCells = tuple[float, float, float, float]
"""(c, s, x0, y0), which transform points of the map to cells of the grid: see `to_cells`."""


def plain(poses: Poses) -> NDArray[np.float64]:
    """Return the array as C-ordered, aligned, writeable float64; a copy only if needed."""
    if type(poses) is np.ndarray and poses.dtype == np.float64:
        # The same as `np.require`, in a tenth of the time.
        return poses if poses.flags.carray else poses.copy()
    return np.require(poses, np.float64, ["C", "A", "W"])


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view, also of an array that is mapped from a file."""
    if type(array) is np.ndarray and array.flags.c_contiguous and not array.flags.writeable:
        return array
    view = np.ascontiguousarray(array).view(np.ndarray)
    view.flags.writeable = False
    return view


def checked(array: NDArray[Any], dtype: type[np.generic], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return a read-only view of an array that fits a map: kernels check no indices.

    Raises:
        ValueError: the array has another type, or the shape of another map.
    """
    if array.dtype != dtype or array.shape != shape:
        expected = f"expected {dtype.__name__} of {shape}"
        raise ValueError(f"an array of a map is {array.dtype} of {array.shape}, {expected}")
    return read_only(array)


def to_cells(map_from_grid: Pose, cell_m: float) -> ToCells:
    """Return (c, s, x0, y0), which transform points of the map to cells of the grid.

    A point (x, y) [m] lies at column c x - s y + x0 and row s x + c y + y0; its cell is the floor
    of both.
    """
    x, y, heading = (float(value) for value in map_from_grid)
    c, s = cos(heading) / cell_m, sin(heading) / cell_m
    return c, -s, -c * x - s * y, s * x - c * y
