"""Clusters that have come to the same place: which of them are one (section 4 of the paper)."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import Poses
from particle_filter.poses import heading_distance


def is_near(
    pose: Sequence[float], means: Iterable[Sequence[float]], distance_m: float, heading_rad: float
) -> bool:
    """Whether one of some means is near to a pose in x, y *and* heading.

    Args:
        pose: (3,) x, y [m] and heading [rad].
        means: (3,) each.
        distance_m: at most so far apart [m].
        heading_rad: and at most so far in heading [rad].
    """
    return any(
        np.hypot(mean[0] - pose[0], mean[1] - pose[1]) <= distance_m
        and heading_distance(mean[2], pose[2]) <= heading_rad
        for mean in means
    )


def merge_overlapping(means: Poses, distance_m: float, heading_rad: float) -> NDArray[np.int64]:
    """Find for every cluster the one that absorbs it.

    Each cluster in turn joins the first earlier one, itself not absorbed, that is near in x, y
    *and* heading. A row of clusters, each near the next, therefore does not collapse into one:
    only what is near the absorbing cluster's own mean goes.

    Args:
        means: (K, 3) mean poses, the most probable first.
        distance_m: means at most this far apart may be one [m].
        heading_rad: and at most this far in heading [rad].

    Returns:
        (K,) index of the absorbing cluster; its own index where a cluster stays.
    """
    absorber = np.arange(len(means), dtype=np.int64)
    for k in range(1, len(means)):
        apart_m = np.hypot(means[:k, 0] - means[k, 0], means[:k, 1] - means[k, 1])
        turned = heading_distance(means[:k, 2], means[k, 2])
        near = (apart_m <= distance_m) & (turned <= heading_rad) & (absorber[:k] == np.arange(k))
        if near.any():
            absorber[k] = np.argmax(near)
    return absorber
