"""A cloud of particles for those who draw one, from the clouds of all clusters."""

import numpy as np
from numpy.typing import NDArray

from particle_filter.poses import between, compose
from protocol.answers import Belief
from protocol.work import Particles

CLOUD = 2_000
"""Particles told, as many as AMCL has at most."""


class ClusterParticles:
    """The newest particles that workers have told of each cluster: every tenth step of each."""

    def __init__(self) -> None:
        self._clouds: dict[int, Particles] = {}

    def on_particles(self, cluster: int, particles: Particles) -> None:
        """Take what a worker tells."""
        self._clouds[cluster] = particles

    def cloud(self, belief: Belief) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Particles of all clusters, each with its share, carried forward to the belief.

        Returns:
            (N, 3) poses and (N,) weights that sum to one; None while no particles are known.
        """
        places = {one.cluster: one.probability for one in belief.hypotheses}
        self._clouds = {number: self._clouds[number] for number in places if number in self._clouds}
        poses, weights = [np.empty((0, 3))], [np.empty(0)]
        for number, cloud in self._clouds.items():
            drawn = _drawn(cloud, max(1, round(CLOUD * places[number])))
            moved = between(np.array(cloud.odom_from_robot), np.array(belief.odom_from_robot))
            poses.append(compose(drawn, moved))
            weights.append(np.full(len(drawn), places[number] / len(drawn)))
        total = sum(float(np.sum(some)) for some in weights)
        if total <= 0.0:
            return None
        return np.concatenate(poses), np.concatenate(weights) / total


def _drawn(cloud: Particles, count: int) -> NDArray[np.float64]:
    """So many particles of a cloud, each as often as its weight says."""
    log_weights = cloud.log_weights.array()
    summed = np.cumsum(np.exp(log_weights - np.max(log_weights), dtype=np.float64))
    marks = (np.arange(count) + 0.5) / count * summed[-1]
    chosen: NDArray[np.float64] = cloud.map_from_robot.array()[np.searchsorted(summed, marks)]
    return chosen.astype(np.float64)
