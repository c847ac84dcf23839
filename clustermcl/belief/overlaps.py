"""Finds clusters at the same place (section 4 of the paper)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clustermcl.filter.arrays import Poses
from clustermcl.filter.poses import heading_distance

_BLOCK = 64
"""Number of clusters, ordered by x, that are compared together."""


def is_near(
    poses: ArrayLike, others: ArrayLike, distance_m: float, heading_rad: float
) -> NDArray[np.bool_]:
    """Find the poses that have one of the others near in x, y *and* heading.

    Args:
        poses: (N, 3) x, y [m] and heading [rad].
        others: (M, 3) poses to compare with.
        distance_m: largest distance between near poses [m].
        heading_rad: largest difference in heading [rad].

    Returns:
        (N,) whether each pose has another pose near it.
    """
    here, there = np.reshape(poses, (-1, 1, 3)), np.reshape(others, (1, -1, 3))
    apart_m = np.hypot(there[..., 0] - here[..., 0], there[..., 1] - here[..., 1])
    turned = heading_distance(there[..., 2], here[..., 2])
    near: NDArray[np.bool_] = ((apart_m <= distance_m) & (turned <= heading_rad)).any(axis=1)
    return near


def merge_overlapping(means: Poses, distance_m: float, heading_rad: float) -> NDArray[np.int64]:
    """Find the cluster that absorbs each cluster.

    Each cluster in turn joins the first earlier cluster that is near in x, y *and* heading and is
    not absorbed itself. So a row of clusters, each near the next, does not collapse into one.

    Args:
        means: (K, 3) mean poses, the most probable first.
        distance_m: largest distance between means to merge [m].
        heading_rad: largest difference in heading [rad].

    Returns:
        (K,) index of the absorbing cluster; its own index where a cluster stays.
    """
    absorber = np.arange(len(means), dtype=np.int64)
    by_x = np.argsort(means[:, 0])
    reach = means[by_x, 0] + (1.0 + 1e-9) * distance_m  # a little more; exact below
    until = np.searchsorted(means[by_x, 0], reach, side="right")
    near = [np.empty((0, 2), np.int64)]
    for start in range(0, len(means), _BLOCK):
        rows = by_x[start : start + _BLOCK]
        others = by_x[start : until[start + len(rows) - 1]]
        near_y = np.abs(means[rows, None, 1] - means[others, 1]) <= distance_m
        row, other = np.nonzero(np.triu(near_y, 1))
        one, two = rows[row], others[other]
        apart_m = np.hypot(*(means[one, :2] - means[two, :2]).T)
        turned = heading_distance(means[one, 2], means[two, 2])
        pairs = np.column_stack((np.maximum(one, two), np.minimum(one, two)))
        near.append(pairs[(apart_m <= distance_m) & (turned <= heading_rad)])
    for k, into in sorted(np.concatenate(near).tolist()):
        if absorber[k] == k and absorber[into] == into:
            absorber[k] = into
    return absorber
