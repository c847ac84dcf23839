"""One particle set for display, combined from the particles of all clusters."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.poses import between, compose
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.work import Particles

CLOUD = 2_000
"""Number of published particles, AMCL's maximum."""


@dataclass(frozen=True)
class _Cloud:
    """The newest particles of a cluster, with the odometry at their step."""

    odom_from_robot: NDArray[np.float64]
    map_from_robot: NDArray[np.float64]
    """(N, 3) poses."""
    summed: NDArray[np.float64]
    """(N,) cumulative weights."""

    def drawn(self, count: int) -> NDArray[np.float64]:
        """Return the (count, 3) poses of a systematic resampling."""
        marks = (np.arange(count) + 0.5) / count * self.summed[-1]
        chosen: NDArray[np.float64] = self.map_from_robot[np.searchsorted(self.summed, marks)]
        return chosen


class ClusterParticles:
    """The newest particles of each cluster; workers report them every tenth step."""

    def __init__(self) -> None:
        self._clouds: dict[int, _Cloud] = {}

    def on_particles(self, cluster: int, particles: Particles) -> None:
        log_weights = particles.log_weights.array()
        self._clouds[cluster] = _Cloud(
            np.array(particles.odom_from_robot),
            particles.map_from_robot.array().astype(np.float64),
            np.cumsum(np.exp(log_weights - np.max(log_weights), dtype=np.float64)),
        )

    def cloud(self, belief: Belief) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Sample the particles of all clusters by probability, moved by odometry to the belief.

        Returns:
            (N, 3) poses and (N,) weights that sum to one; None while no particles are known.
        """
        places = {one.cluster: one.probability for one in belief.hypotheses}
        at = {one.cluster: one.pose for one in belief.hypotheses}
        self._clouds = {number: self._clouds[number] for number in places if number in self._clouds}
        total = sum(places[number] for number in self._clouds)
        if total <= 0.0:
            return None
        odometry, poses, weights = np.array(belief.odom_from_robot), [], []
        for number, cloud in self._clouds.items():
            count = max(1, round(CLOUD * places[number]))
            moved = compose(cloud.drawn(count), between(cloud.odom_from_robot, odometry))
            if belief.floors:  # particles are in the atlas, places on their floor
                moved[:, :2] += np.array(at[number][:2]) - moved[:, :2].mean(axis=0)
            poses.append(moved)
            weights.append(np.full(count, places[number] / total / count))
        return np.concatenate(poses), np.concatenate(weights)
