"""Refines approximate poses by random local search."""

import numpy as np

from particle_filter.arrays import LogWeights, Points, Poses
from particle_filter.likelihood_field import LikelihoodField, scan_log_likelihood

_TRIES = 200
_SPREADS = np.array([(s, s, 0.25 * s) for s in (0.4, 0.2, 0.1, 0.05, 0.02)])
"""Standard deviations of the trials: x [m], y [m], heading [rad]. That of the heading is a
quarter, because beams end metres away."""


def refined(
    poses: Poses, hits_in_robot: Points, field: LikelihoodField, rng: np.random.Generator
) -> tuple[Poses, LogWeights]:
    """Improve each pose by trials in a shrinking neighbourhood.

    Args:
        poses: (N, 3).
        hits_in_robot: (B, 2) end points of beams [m].
        field: likelihood field of the map.
        rng: draws the trials.

    Returns:
        (N, 3) poses, none less likely than before, and their (N,) log-likelihoods.
    """
    every = np.arange(len(poses))
    for spread in _SPREADS:
        steps = spread * rng.standard_normal((len(poses), _TRIES, 3))
        steps[:, 0] = 0.0
        tried = poses[:, None, :] + steps
        scores = scan_log_likelihood(tried.reshape(-1, 3), hits_in_robot, field)
        best = scores.reshape(len(poses), _TRIES).argmax(axis=1)
        poses, found = tried[every, best], scores.reshape(len(poses), _TRIES)[every, best]
    return poses, found
