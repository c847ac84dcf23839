"""The places that a weighted cloud holds, by source points (section 4): found, and told."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import LogWeights, Pose, Poses
from particle_filter.cluster_filter import Cloud
from particle_filter.gaussian import fit_gaussians
from particle_filter.kernels import kernel
from particle_filter.log_weights import normalised_weights
from particle_filter.resampling import systematic
from particle_filter.settings import SearchSettings
from particle_filter.slices import Slices, finished
from particle_filter.source_clustering import Labels, cluster_by_source_point


@dataclass(frozen=True)
class FoundPlace:
    """One place that a search holds possible."""

    share: float
    mean: Pose
    covariance: Poses
    sample: Poses
    """(M, 3) particles drawn from it, all alike."""


@dataclass(frozen=True)
class Parts:
    """Weighted poses, place by place; those of no place are left out."""

    poses: Poses
    weights: NDArray[np.float64]
    shares: NDArray[np.float64]
    """(K,) of all weights, also of those of no place."""
    ends: NDArray[np.int64]
    """(K + 1,) where each place's poses end and the next one's begin."""

    @classmethod
    def of(cls, poses: Poses, weights: NDArray[np.float64], labels: Labels, count: int) -> "Parts":
        """Of `count` places, by the (N,) labels of the poses; -1: of no place."""
        by_label = np.argsort(labels, kind="stable")
        sizes = np.bincount(labels + 1, minlength=count + 1)
        chosen = by_label[sizes[0] :]
        shares = np.bincount(labels + 1, weights, minlength=count + 1)[1:].astype(np.float64)
        ends = np.cumsum(sizes) - sizes[0]
        return cls(poses.take(chosen, axis=0), weights.take(chosen), shares, ends)

    def __getitem__(self, place: np.intp) -> tuple[Poses, NDArray[np.float64]]:
        """A place's poses, and their weights, which sum to one."""
        own = slice(self.ends[place], self.ends[place + 1])
        return self.poses[own], self.weights[own] / self.shares[place]


def places_of(
    cloud: Cloud, rules: SearchSettings, min_share: float, rng: np.random.Generator
) -> list[FoundPlace]:
    """Cluster a cloud by source points (section 4).

    Args:
        cloud: N particles.
        rules: how near a point must be to its cluster's source, and how large samples are.
        min_share: places with less of the weight are left out.
        rng: draws the samples.

    Returns:
        Most probable first.
    """
    labels, _ = clustered(cloud.map_from_robot, cloud.log_weights, rules)
    return finished(found_places(cloud, labels, rules, min_share, rng))


def clustered(poses: Poses, log_weights: LogWeights, rules: SearchSettings) -> tuple[Labels, int]:
    """Each pose's place, and how many there are: see `cluster_by_source_point`."""
    return cluster_by_source_point(
        poses, log_weights, rules.source_radius_m, rules.source_heading_rad, rules.places
    )


def found_places(
    cloud: Cloud,
    labels: Labels,
    rules: SearchSettings,
    min_share: float,
    rng: np.random.Generator,
) -> Slices[list[FoundPlace]]:
    """As `places_of`, in slices, of a cloud whose places are known."""
    weights = normalised_weights(cloud.log_weights)
    parts = Parts.of(cloud.map_from_robot, weights, labels, int(labels.max(initial=-1)) + 1)
    means, covariances = fit_gaussians(parts.poses, parts.weights, parts.ends)
    yield
    by_share = np.argsort(-parts.shares, kind="stable")
    told = by_share[: np.count_nonzero(parts.shares >= min_share)]
    counts = np.ones(len(told), np.int64)
    counts[: rules.places_with_particles] = rules.hand_over_particles
    drawn = _drawn(parts.weights, parts.shares, parts.ends, told, counts, rng.random(len(told)))
    yield
    samples = parts.poses.take(drawn, axis=0)
    return [
        FoundPlace(
            float(parts.shares[label]), means[label], covariances[label], samples[end - count : end]
        )
        for label, count, end in zip(told, counts, np.cumsum(counts), strict=True)
    ]


@kernel
def _drawn(
    weights: NDArray[np.float64],
    shares: NDArray[np.float64],
    ends: NDArray[np.int64],
    told: NDArray[np.int64],
    counts: NDArray[np.int64],
    offsets: NDArray[np.float64],
) -> NDArray[np.int64]:
    """So many poses of each place that is told, drawn systematically by their weights."""
    drawn, made = np.empty(counts.sum(), np.int64), 0
    for place in range(len(told)):
        label, count = told[place], counts[place]
        first, end = ends[label], ends[label + 1]
        own = weights[first:end] / shares[label]
        drawn[made : made + count] = first + systematic(own, count, offsets[place])
        made += count
    return drawn
