"""The decorator of compiled functions (numba, cached on disk), and checks of their arguments.

`kernel` imports numba at its first call, so processes without mathematics never import it.
`NUMBA_DISABLE_JIT=1` runs every kernel as plain Python.
"""

from collections.abc import Callable
from functools import partial
from math import cos, sin
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import F, Pose, Poses

cache_problems: list[str] = []
"""Reasons why machine code could not be read from disk or written, logged at the start."""

on_compile: list[Callable[[str], None]] = []
"""Functions to call with the name of each kernel before it is compiled. A kernel is read from
disk if it was compiled before."""


def kernel(function: F) -> F:
    """Compile `function` at its first call and keep the machine code on disk.

    Bounds are not checked and integers do not promote: kernels get checked arguments.
    ``fastmath`` stays off, so that results do not depend on how a loop was vectorised.
    """
    from numba import njit  # noqa: PLC0415 - heavy; only processes that compute pay for it

    compile_lazily = partial(njit, error_model="numpy", boundscheck=False)
    try:
        compiled = compile_lazily(cache=True)(function)
    except RuntimeError:  # of numba, which finds no folder for its files
        cache_problems.append("no folder for them can be written")
        return cast(F, compile_lazily()(function))
    if hasattr(compiled, "_cache"):  # it is compiled, not plain Python
        _stamp_with_callees(compiled, function)
        for method in ("load_overload", "save_overload"):
            setattr(
                compiled._cache, method, _ignoring_cache_errors(getattr(compiled._cache, method))
            )
        compiled._cache.load_overload = _announced(compiled._cache.load_overload, function.__name__)
    return cast(F, compiled)


def _announced(load: Callable[..., Any], name: str) -> Callable[..., Any]:
    def load_or_announce(*arguments: Any) -> Any:
        if (code := load(*arguments)) is None:
            for announce in on_compile:
                announce(name)
        return code

    return load_or_announce


def _ignoring_cache_errors(method: Callable[..., Any]) -> Callable[..., Any]:
    """Ignore errors of the disk cache: the kernel is compiled instead."""

    def forgiving(*arguments: Any) -> Any:
        try:
            return method(*arguments)
        except Exception as error:  # noqa: BLE001 - a damaged cache file may raise anything
            cache_problems.append(str(error) or type(error).__name__)
            return None  # numba then compiles the kernel

    return forgiving


def _stamp_with_callees(compiled: Any, function: Any) -> None:
    """Invalidate cached machine code when a kernel that it calls in another file has changed.

    Numba compares only time and size of the kernel's own file, although callees are inlined.
    """
    named = [function.__globals__.get(name) for name in function.__code__.co_names]
    files = [kernel._cache._cache_file for kernel in named if hasattr(kernel, "_cache")]
    if files:
        own = compiled._cache._cache_file
        own._source_stamp = (own._source_stamp, *(file._source_stamp for file in files))


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


def to_cells(map_from_grid: Pose, cell_m: float) -> ToCells:
    """Return (c, s, x0, y0), which transform points of the map to cells of the grid.

    A point (x, y) [m] lies at column c x - s y + x0 and row s x + c y + y0; its cell is the floor
    of both.
    """
    x, y, heading = (float(value) for value in map_from_grid)
    c, s = cos(heading) / cell_m, sin(heading) / cell_m
    return c, -s, -c * x - s * y, s * x - c * y
