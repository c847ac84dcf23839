"""The one typed door to compiled code: numba, cached on disk.

Kept apart from the array types so that processes without mathematics never import numba.
`NUMBA_DISABLE_JIT=1` runs every kernel as plain Python.
"""

from typing import cast

from particle_filter.arrays import F


def kernel(function: F) -> F:
    """Compile `function` at its first call and keep the machine code on disk.

    Bounds are not checked and integers do not promote: kernels get checked arguments.
    ``fastmath`` stays off, so that results do not depend on how a loop was vectorised.
    """
    from numba import njit  # noqa: PLC0415 - heavy; only processes that compute pay for it

    compiled = njit(cache=True, error_model="numpy", boundscheck=False)(function)
    return cast(F, compiled)
