"""The one typed door to compiled code: numba, cached on disk.

Kept apart from the array types so that processes without mathematics never import numba.
`NUMBA_DISABLE_JIT=1` runs every kernel as plain Python.
"""

from typing import Any, cast

from particle_filter.arrays import F


def kernel(function: F) -> F:
    """Compile `function` at its first call and keep the machine code on disk.

    Bounds are not checked and integers do not promote: kernels get checked arguments.
    ``fastmath`` stays off, so that results do not depend on how a loop was vectorised.
    """
    from numba import njit  # noqa: PLC0415 - heavy; only processes that compute pay for it

    compiled = njit(cache=True, error_model="numpy", boundscheck=False)(function)
    _stamp_with_callees(compiled, function)
    return cast(F, compiled)


def _stamp_with_callees(compiled: Any, function: Any) -> None:
    """Let machine code on disk be stale when a kernel of another file that it calls has changed.

    Numba looks at the time and size of the kernel's own file only, although callees are compiled
    into it.
    """
    named = [function.__globals__.get(name) for name in function.__code__.co_names]
    files = [kernel._cache._cache_file for kernel in named if hasattr(kernel, "_cache")]
    if files:
        own = compiled._cache._cache_file
        own._source_stamp = (own._source_stamp, *(file._source_stamp for file in files))
