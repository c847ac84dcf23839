"""The record of one run, by step and cluster, and its file format."""

from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ELSEWHERE_POSES = (1024, 2048, 8192)
"""Numbers of uniform poses of which the scan's mean likelihood is recorded."""
NOWHERE = -1
"""`copy` of a cluster that is neither at the truth nor at a place that looks like it."""


@dataclass(frozen=True, eq=False)
class Record:
    """One run of T steps after the first, with K clusters; logarithms are natural."""

    experiment: str
    seed: int
    start_step: int
    share: Floats
    """(K,) of the first scan's posterior over the free space, at each place."""
    first_fit: float
    """Best log-likelihood a beam of the first scan, without exponent."""
    planted: int
    """Cluster that was put at the truth, because the first scan's places had none there; or -1."""
    evidence: Floats
    """(T, K) log average likelihood of the scan; NaN from when a cluster has been merged."""
    fit: Floats
    """(T, K) best particle's log-likelihood a beam, without exponent."""
    copy: NDArray[np.int8]
    """(T, K) symmetric copy of the truth that the cluster is at; 0 is the truth itself."""
    ess: Floats
    """(T, K) effective sample size."""
    into: NDArray[np.int16]
    """(T, K) the cluster that this one becomes part of after the step; itself, if of none."""
    distance_m: Floats
    """(T,) driven since the step before, by odometry."""
    turn_rad: Floats
    """(T,)"""
    beams: NDArray[np.int16]
    """(T,)"""
    known: NDArray[np.bool_]
    """(T,) whether the truth is known."""
    elsewhere: Floats
    """(T, 3) log mean likelihood of ELSEWHERE_POSES uniform poses."""
    elsewhere_fit: Floats
    """(T, 3) log-likelihood a beam of the best of them, without exponent."""
    kidnapped_at: int = -1
    """The first step after which nothing that was known holds; -1: none."""

    @property
    def right(self) -> NDArray[np.bool_]:
        """(T, K) whether the cluster is at the true place."""
        return self.copy == 0


def save(records: list[Record], file: Path) -> None:
    """Write the records into one .npz file."""
    arrays = {
        f"{index}/{name}": np.asarray(value)
        for index, record in enumerate(records)
        for name, value in asdict(record).items()
    }
    with file.open("wb") as stream:
        np.savez_compressed(stream, **arrays)


def load(file: Path) -> list[Record]:
    """Read them again."""
    with np.load(file) as arrays:
        count = len({name.split("/")[0] for name in arrays})
        return [
            Record(**{f.name: _plain(arrays[f"{index}/{f.name}"]) for f in fields(Record)})
            for index in range(count)
        ]


def _plain(array: NDArray) -> object:  # type: ignore[type-arg] # of any kind
    return array.item() if array.ndim == 0 else array
