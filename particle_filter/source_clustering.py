"""Clusters of particles around source points (section 4 of the paper, "Algorithm")."""

from math import floor, inf, pi

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import LogWeights, Pose, Poses
from particle_filter.kernel_arguments import plain
from particle_filter.kernels import kernel

Labels = NDArray[np.int32]


def cluster_by_source_point(
    poses: Poses, log_weights: LogWeights, radius_m: float, heading_rad: float, max_clusters: int
) -> tuple[Labels, int]:
    """Give each particle to the cluster whose source point is near, else let it found one.

    Heavier particles come first, so that sources are good poses; equal weights in the order
    given. Near means within `radius_m` in the plane *and* within `heading_rad` the short way
    round; of several near sources the nearest, with both distances in units of their limits.

    Args:
        poses: (N, 3).
        log_weights: (N,); only their order counts.
        radius_m: reach of a source in x, y [m].
        heading_rad: reach of a source in heading [rad].
        max_clusters: afterwards nobody founds a cluster.

    Returns:
        (N,) number of each particle's cluster, clusters numbered as they were founded; -1 for a
        particle near none when no more could be founded. And the number of clusters.

    Raises:
        ValueError: a reach or `max_clusters` is not positive, a weight is NaN, or a pose is
            not finite.
    """
    if not (radius_m > 0.0 and heading_rad > 0.0 and max_clusters > 0):
        raise ValueError("radius_m, heading_rad and max_clusters must be positive")
    if np.isnan(log_weights).any() or not np.isfinite(poses).all():
        raise ValueError("poses must be finite and weights not NaN")
    order = np.argsort(-log_weights, kind="stable")
    labels, count = _assign(
        plain(poses), order, float(radius_m), float(heading_rad), int(max_clusters)
    )
    return labels, int(count)


@kernel
def _assign(
    poses: Poses, order: NDArray[np.int64], radius_m: float, heading_rad: float, max_clusters: int
) -> tuple[Labels, int]:
    # Sources lie in a hash grid whose cells are as wide as the reach: all sources near a
    # particle are in its own cell or in a neighbour.
    sectors = max(1, floor(2.0 * pi / heading_rad))
    buckets = 16
    while buckets < 2 * max_clusters and buckets < 2 * len(order):
        buckets *= 2
    first = np.full(buckets, -1, np.int64)  # newest cluster in a bucket
    following = np.empty(min(max_clusters, len(order)), np.int64)  # the one before it there
    sources = np.empty((len(following), 3))
    labels = np.full(len(order), -1, np.int32)
    count = 0
    for i in order:
        col, row = floor(poses[i, 0] / radius_m), floor(poses[i, 1] / radius_m)
        turns = poses[i, 2] / (2.0 * pi)
        sector = min(floor((turns - floor(turns)) * sectors), sectors - 1)
        home = (col, row, sector, sectors)
        cluster = _nearest(poses[i], sources, (first, following), home, (radius_m, heading_rad))
        if cluster < 0 and count < max_clusters:
            cluster = count
            sources[cluster] = poses[i]
            bucket = _bucket(col, row, sector, buckets)
            following[cluster], first[bucket] = first[bucket], cluster
            count += 1
        labels[i] = cluster
    return labels, count


@kernel
def _nearest(
    pose: Pose,
    sources: Poses,
    chains: tuple[NDArray[np.int64], NDArray[np.int64]],
    home: tuple[int, int, int, int],
    reach: tuple[float, float],
) -> int:
    """The cluster with the nearest source in reach of a pose, the older at a tie; -1 for none."""
    first, following = chains
    col, row, sector, sectors = home
    best, best_distance = -1, inf
    for d_sector in range(min(sectors, 3)):
        near_sector = (sector + d_sector + sectors - 1) % sectors
        for near_col in range(col - 1, col + 2):
            for near_row in range(row - 1, row + 2):
                cluster = first[_bucket(near_col, near_row, near_sector, len(first))]
                while cluster >= 0:
                    distance = _distance(pose, sources[cluster], reach)
                    if distance < best_distance or (distance == best_distance and cluster < best):
                        best, best_distance = cluster, distance
                    cluster = following[cluster]
    return best


@kernel
def _distance(a: Pose, b: Pose, reach: tuple[float, float]) -> float:
    """Squared distance in units of the reach; infinite out of reach."""
    radius_m, heading_rad = reach
    apart = ((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2) / radius_m**2
    turns = (b[2] - a[2]) / (2.0 * pi)
    turned = (turns - floor(turns + 0.5)) * 2.0 * pi / heading_rad
    if apart > 1.0 or abs(turned) > 1.0:
        return inf
    return float(apart + turned**2)


@kernel
def _bucket(col: int, row: int, sector: int, buckets: int) -> int:
    """Spread grid cells over buckets; cells that share one are told apart by distance."""
    return (col * 73856093 ^ row * 19349663 ^ sector * 83492791) & (buckets - 1)
