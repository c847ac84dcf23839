"""Random numbers that depend on their purpose, not on the process or the order of draws.

Philox is a keyed function of a 256-bit counter. The key is (seed, purpose); the three upper
words of the counter are (entity, step, part), and a generator counts only in the lowest word.
So generators of different arguments share no block of numbers, and the same arguments give the
same numbers in every process and after every restart.

References:
    Salmon et al., "Parallel random numbers: as easy as 1, 2, 3" (2011).
"""

from enum import IntEnum

import numpy as np

_WORD = 2**64


class Purpose(IntEnum):
    """The purpose of random numbers. Values never change, because recorded runs depend on them."""

    TRACK = 1
    """One step of one cluster; the entity is the cluster."""
    SEARCH = 2
    """One step of a global search; the entity is the search, and each shard has four parts."""
    START = 3
    """The first particles of a cluster; the entity is the cluster."""
    GIVEN_POSE = 4
    """Particles around a given pose; the entity counts given poses."""
    LAST_POSE = 5
    """Particles around the last pose of an earlier run; the entity is 0."""
    REBUILT = 6
    """Particles of a cluster whose particles were lost; the entity is the cluster."""
    ELSEWHERE = 7
    """One step's poses all over the map; the entity is 0."""
    RIDE = 8
    """Particles of a place at the other end of a link; the entity counts clusters."""


def generator(
    seed: int, *, purpose: Purpose, entity: int, step: int, part: int = 0
) -> np.random.Generator:
    """Create the random generator for one piece of work.

    Raises:
        ValueError: an argument is negative or does not fit 64 bits.
    """
    numbers = {"seed": seed, "entity": entity, "step": step, "part": part}
    if min(numbers.values()) < 0 or max(numbers.values()) >= _WORD:
        raise ValueError(f"numbers must be in 0 .. 2**64 - 1, not {numbers}")
    counter = np.array([0, entity, step, part], np.uint64)
    return np.random.Generator(
        np.random.Philox(key=np.array([seed, purpose], np.uint64), counter=counter)
    )
