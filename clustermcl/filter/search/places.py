"""Finds the places in a particle set: clusters around source points (section 4 of the paper)."""

from dataclasses import dataclass
from math import floor, inf, pi

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import LogWeights, Pose, Poses
from clustermcl.filter.cluster.cluster_filter import ParticleSet
from clustermcl.filter.cluster.gaussian import fit_gaussians
from clustermcl.filter.kernels.compiled import kernel, plain
from clustermcl.filter.log_weights import normalised_weights
from clustermcl.filter.resampling import systematic
from clustermcl.filter.settings import FilterSettings, SearchSettings
from clustermcl.filter.slices import Slices, finished

Labels = NDArray[np.int32]


def cluster_by_source_point(
    poses: Poses, log_weights: LogWeights, radius_m: float, heading_rad: float, max_clusters: int
) -> tuple[Labels, int]:
    """Assign each particle to the cluster with a near source point, or begin a new cluster.

    Heavier particles come first, so that sources are good poses; equal weights keep their order.
    A source is near within `radius_m` in the plane *and* within `heading_rad`. Of several near
    sources the nearest counts, with both distances divided by their limits.

    Returns:
        (N,) cluster of each particle, numbered in the order of their beginning, or -1 if none is
        near and no more may begin; and the number of clusters.

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
    following = np.empty(
        min(max_clusters, len(order)), np.int64
    )  # the next older cluster in its bucket
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
    """Return the cluster with the nearest source in reach, the older of equals; -1: none."""
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
    """Return the squared distance of two poses in units of `reach`; infinite if one is exceeded."""
    radius_m, heading_rad = reach
    apart = ((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2) / radius_m**2
    turns = (b[2] - a[2]) / (2.0 * pi)
    turned = (turns - floor(turns + 0.5)) * 2.0 * pi / heading_rad
    if apart > 1.0 or abs(turned) > 1.0:
        return inf
    return float(apart + turned**2)


@kernel
def _bucket(col: int, row: int, sector: int, buckets: int) -> int:
    """Return the bucket of a cell of the hash grid; several cells may share a bucket."""
    return (col * 73856093 ^ row * 19349663 ^ sector * 83492791) & (buckets - 1)


@dataclass(frozen=True)
class FoundPlace:
    """A place where the robot may be."""

    share: float
    """Share of all weights, from 0 to 1."""
    mean: Pose
    covariance: Poses
    sample: Poses
    """(M, 3) equally weighted particles drawn from the place."""


@dataclass(frozen=True)
class Parts:
    """Weighted poses ordered by place; poses without a place are left out."""

    poses: Poses
    weights: NDArray[np.float64]
    shares: NDArray[np.float64]
    """(K,) each place's share of all weights, including those without a place."""
    ends: NDArray[np.int64]
    """(K + 1,) index at which the poses of each place begin, and the number of all poses."""

    @classmethod
    def of(cls, poses: Poses, weights: NDArray[np.float64], labels: Labels, count: int) -> "Parts":
        """Order poses by their (N,) labels: the number of one of `count` places, or -1."""
        by_label = np.argsort(labels, kind="stable")
        sizes = np.bincount(labels + 1, minlength=count + 1)
        chosen = by_label[sizes[0] :]
        shares = np.bincount(labels + 1, weights, minlength=count + 1)[1:].astype(np.float64)
        ends = np.cumsum(sizes) - sizes[0]
        return cls(poses.take(chosen, axis=0), weights.take(chosen), shares, ends)


def places_of(
    particles: ParticleSet, settings: FilterSettings, rng: np.random.Generator
) -> list[FoundPlace]:
    """Cluster particles by source points (section 4); return the places, the most probable first.

    Those with a smaller share of the weight than `least_probability` are left out.
    """
    labels, _ = clustered(particles.map_from_robot, particles.log_weights, settings.search)
    return finished(found_places(particles, labels, settings, rng))


def clustered(poses: Poses, log_weights: LogWeights, rules: SearchSettings) -> tuple[Labels, int]:
    """Call `cluster_by_source_point` with the settings of a search."""
    return cluster_by_source_point(poses, log_weights, *rules.reach, rules.places)


def found_places(
    particles: ParticleSet,
    labels: Labels,
    settings: FilterSettings,
    rng: np.random.Generator,
) -> Slices[list[FoundPlace]]:
    """Return places as `places_of` does, in slices, for particles with known labels."""
    weights = normalised_weights(particles.log_weights)
    parts = Parts.of(particles.map_from_robot, weights, labels, int(labels.max(initial=-1)) + 1)
    means, covariances = fit_gaussians(parts.poses, parts.weights, parts.ends, parts.shares)
    yield
    by_share = np.argsort(-parts.shares, kind="stable")
    reported = by_share[: np.count_nonzero(parts.shares >= settings.belief.least_probability)]
    counts = np.ones(len(reported), np.int64)
    counts[: settings.belief.max_clusters] = settings.search.hand_over_particles
    drawn = _drawn(
        parts.weights, parts.shares, parts.ends, reported, counts, rng.random(len(reported))
    )
    yield
    samples = parts.poses.take(drawn, axis=0)
    return [
        FoundPlace(
            float(parts.shares[label]), means[label], covariances[label], samples[end - count : end]
        )
        for label, count, end in zip(reported, counts, np.cumsum(counts), strict=True)
    ]


@kernel
def _drawn(
    weights: NDArray[np.float64],
    shares: NDArray[np.float64],
    ends: NDArray[np.int64],
    reported: NDArray[np.int64],
    counts: NDArray[np.int64],
    offsets: NDArray[np.float64],
) -> NDArray[np.int64]:
    """Draw `counts` poses of each reported place by weight; return their indices."""
    drawn, made = np.empty(counts.sum(), np.int64), 0
    for place in range(len(reported)):
        label, count = reported[place], counts[place]
        first, end = ends[label], ends[label + 1]
        own = weights[first:end] / shares[label]
        drawn[made : made + count] = first + systematic(own, count, offsets[place])
        made += count
    return drawn
