"""Evidence of landmarks that a robot is expected to see at a view."""

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Poses
from clustermcl.filter.laser.ray_casting import cast_rays_from_poses
from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.filter.observations.kind import Landmarks
from clustermcl.filter.observations.likelihood import log_likelihood_ratio
from clustermcl.filter.observations.sighting import Sighting
from clustermcl.filter.poses import between

SIGHT_M = 3.0
"""Distance up to which a landmark is expected to be seen [m]."""
_DETECTED = 0.5
"""Share of the landmarks in sight that are expected to be seen: a camera may look elsewhere."""
_BEHIND_M = 0.3
"""A landmark is in sight if the ray to it ends no more than this before it [m]."""
_SIGMA_M, _OUTLIER_PROBABILITY = 0.1, 0.05


def landmark_evidence(
    at: Poses, around: Poses, landmarks: Landmarks, model: SensorModel
) -> tuple[NDArray[np.float64], frozenset[str]]:
    """Predict what is seen at a view, and weigh it at all places.

    The view has a pose (K, 3) in the map for each place of the robot; the (K, N, 3) poses around
    may be the right ones.

    Returns:
        (K, K) expected log-likelihood ratio of the row's place and the column's, if the row's is
        right; and the names of the landmarks that are seen at one place or more.
    """
    count, grid = len(at), model.grid
    evidence, names = np.zeros((count, count)), set[str]()
    if not landmarks.names:
        return evidence, frozenset()
    marks = np.column_stack([landmarks.positions, np.zeros(len(landmarks.names))])
    poses = around.reshape(-1, 3)
    for k in range(count):
        seen = between(at[k], marks)[:, :2]
        far_m = np.hypot(seen[:, 0], seen[:, 1])
        near = np.flatnonzero(far_m < SIGHT_M)
        if not len(near):
            continue
        angles = np.arctan2(seen[near, 1], seen[near, 0])
        free_m = cast_rays_from_poses(model.jumps, grid, at[k : k + 1], angles, SIGHT_M)[0]
        sights = near[free_m > far_m[near] - _BEHIND_M]
        error = _SIGMA_M**2 * np.eye(2), _OUTLIER_PROBABILITY
        observed = [Sighting(seen[i], *error, landmark=landmarks.names[i]) for i in sights]
        names.update(seen.landmark for seen in observed)
        fits = log_likelihood_ratio(poses, observed, landmarks, grid).reshape(count, -1).max(axis=1)
        evidence[k] = _DETECTED * np.maximum(fits[k] - fits, 0.0)
    return evidence, frozenset(names)
