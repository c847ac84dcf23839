"""The places that a weighted cloud holds, by source points (section 4): found, and told."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import LogWeights, Pose, Poses
from particle_filter.cluster_filter import Cloud
from particle_filter.gaussian import fit_gaussians
from particle_filter.log_weights import normalised_weights
from particle_filter.resampling import resample_weights
from particle_filter.settings import SearchSettings
from particle_filter.slices import Slices, WorkMeter, finished
from particle_filter.source_clustering import Labels, cluster_by_source_point

_PLACE_WORK = 2**14
"""Of telling a place [look-ups]."""


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
    found, meter = list[FoundPlace](), WorkMeter()
    yield
    for label in np.argsort(-parts.shares, kind="stable"):
        share = float(parts.shares[label])
        if share < min_share:
            break
        poses, own = parts[label]
        count = rules.hand_over_particles if len(found) < rules.places_with_particles else 1
        sample = poses.take(resample_weights(own, count, "systematic", rng), axis=0)
        found.append(FoundPlace(share, means[label], covariances[label], sample))
        yield from meter.spend(_PLACE_WORK)
    return found
